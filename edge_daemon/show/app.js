// The page: which view, and one stream of news from the gateway for all of them.
import { NeedToken, T, el, getJson, say, sessionOf } from "./dom.js";
import { CompareView } from "./compare.js";
import { EventsView } from "./events.js";
import { LifeView } from "./life.js";
import { DriveView } from "./drive.js";
import { Overview } from "./overview.js";

const VIEWS = { "": Overview, drive: DriveView, compare: CompareView, life: LifeView, events: EventsView };
const SILENT_MS = 4000;
const RETRY_MS = 1000;
const main = document.getElementById("main");
const contact = document.getElementById("contact");
const troubles = document.getElementById("troubles");
let stream = null;
let streamOf = null;
let view = null;
let state = null;
let heard = Date.now();
let asking = false;

function route() {
  const [name, drive, ...rest] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  return { name: name in VIEWS ? name : "", drive: drive || "", rest };
}

async function show() {
  const { name, drive, rest } = route();
  view?.close();
  view = null;
  main.replaceChildren(el("p", { className: "quiet" }, T.waiting));
  let session;
  try {
    session = await sessionOf();
  } catch (error) {
    if (error instanceof NeedToken) askToken(T.needToken);
    else {
      main.replaceChildren(el("p", { className: "warn" }, T.noAnswer(error.message)));
      setTimeout(show, RETRY_MS);
    }
    return;
  }
  asking = false;
  view = new VIEWS[name](drive, session, rest);
  main.replaceChildren(view.node);
  navigation(name, drive);
  if (state) view.state?.(state);
  listen(drive);
}

function askToken(why) {
  if (asking) return;
  asking = true;
  stream?.close();
  contact.hidden = true;
  view?.close();
  view = null;
  const field = el("input", { type: "password", id: "token", autocomplete: "current-password", required: true });
  const note = el("p", { role: "alert", className: "bad" });
  const open = async (event) => {
    event.preventDefault();
    const answer = await fetch("/api/login", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ token: field.value }) }).catch(() => null);
    if (answer?.ok) {
      heard = Date.now();
      show();
    } else {
      say(note, answer ? T.wrongToken : T.noAnswer(""));
      field.select();
    }
  };
  main.replaceChildren(el("form", { onsubmit: open }, el("p", {}, why), el("div", { className: "row" }, el("label", {}, T.token, field), el("button", { className: "main" }, T.logIn)), note));
  field.focus();
}

function navigation(name, drive) {
  const chosen = drive || state?.drives[0]?.name || "";
  const alone = state?.drives.length === 1;
  const links = alone ? [] : [["", T.views.overview, "#/"]];
  if (chosen) for (const part of ["drive", "compare", "life"]) links.push([part, T.views[part], `#/${part}/${encodeURIComponent(chosen)}`]);
  links.push(["events", T.views.events, "#/events"], ["status", T.views.status, "/status"]);
  const nodes = links.map(([part, text, href]) => el("a", { href, ...(part === name ? { "aria-current": "page" } : {}) }, text));
  document.getElementById("nav").replaceChildren(...nodes, ...(name && chosen && state?.drives.length > 1 ? [choice(name, chosen)] : []));
  document.title = [chosen && name ? chosen : "", name ? T.views[name] : "", state?.gateway ?? "edge-daemon"].filter(Boolean).join(" · ");
}

/** Which drive: the same view of another one. */
function choice(name, chosen) {
  const names = state.drives.map((row) => row.name).sort();
  const go = (event) => (location.hash = `#/${name in { events: 0, "": 0 } ? "drive" : name}/${encodeURIComponent(event.target.value)}`);
  return el("select", { id: "drive", "aria-label": T.drive, onchange: go }, ...names.map((one) => el("option", { value: one, selected: one === chosen }, one)));
}

function listen(drive) {
  if (stream && streamOf === drive && stream.readyState !== EventSource.CLOSED) return;
  stream?.close();
  streamOf = drive;
  stream = new EventSource(`/api/live?drive=${encodeURIComponent(drive)}`);
  stream.addEventListener("state", (event) => take(JSON.parse(event.data)));
  stream.addEventListener("drive", (event) => view?.drive?.(JSON.parse(event.data)));
}

function take(news) {
  const before = state;
  state = news;
  heard = Date.now();
  contact.hidden = true;
  if (before && state.up_s < before.up_s) sessionOf(true).catch(() => {});
  say(document.getElementById("title"), T.title(state.gateway, state.site));
  say(document.getElementById("now"), T.now(state.version, T.ago(state.up_s)));
  if (before?.drives.length !== state.drives.length) navigation(route().name, route().drive);
  showTroubles(state.troubles);
  document.body.classList.remove("lost");
  if (state.drives.length === 1 && !route().name) location.replace(`#/drive/${encodeURIComponent(state.drives[0].name)}`);
  else view?.state?.(state);
}

/** What is wrong with the gateway itself, over every view: a full disk, a lost sensor bus. */
function showTroubles(lines) {
  troubles.hidden = !lines.length;
  const texts = lines.map((line) => T.trouble(line));
  if (texts.join("\n") === troubles.dataset.shown) return;
  troubles.dataset.shown = texts.join("\n");
  troubles.replaceChildren(...texts.map((text) => el("p", {}, text)));
}

setInterval(() => {
  const silent = Date.now() - heard;
  if (silent < SILENT_MS || !view) return;
  say(contact, T.lost(Math.round(silent / 1000)));
  contact.hidden = false;
  document.body.classList.add("lost");
  if (stream?.readyState === EventSource.CLOSED) reconnect();
}, RETRY_MS);

/** The gateway has refused the stream: another token since its restart, too many pages, or it is not up again yet. */
async function reconnect() {
  try {
    await getJson("/api/session");
    listen(route().drive);
  } catch (error) {
    if (error instanceof NeedToken) askToken(T.tokenChanged);
  }
}

addEventListener("hashchange", () => {
  if (location.hash === "#main") return;
  show();
  main.focus();
});
show();
