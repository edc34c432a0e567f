// The page: which view, and one stream of news from the gateway for all of them.
import { NeedToken, T, el, say, sessionOf } from "./dom.js";
import { CompareView } from "./compare.js";
import { EventsView } from "./events.js";
import { LifeView } from "./life.js";
import { DriveView, Overview } from "./live.js";

const VIEWS = { "": Overview, drive: DriveView, compare: CompareView, life: LifeView, events: EventsView };
const SILENT_MS = 4000;
const main = document.getElementById("main");
const contact = document.getElementById("contact");
let stream = null;
let streamOf = null;
let view = null;
let state = null;
let heard = Date.now();

function route() {
  const [name, drive] = location.hash.replace(/^#\/?/, "").split("/").map(decodeURIComponent);
  return { name: name in VIEWS ? name : "", drive: drive || "" };
}

async function show() {
  const { name, drive } = route();
  view?.close();
  view = null;
  main.replaceChildren(el("p", { className: "quiet" }, T.waiting));
  let session;
  try {
    session = await sessionOf();
  } catch (error) {
    if (error instanceof NeedToken) askToken();
    else setTimeout(show, 1000);
    return;
  }
  view = new VIEWS[name](drive, session);
  main.replaceChildren(view.node);
  navigation(name, drive);
  if (state) view.state?.(state);
  listen(drive);
}

function askToken() {
  const field = el("input", { type: "password", id: "token", autocomplete: "current-password", required: true });
  const note = el("p", { role: "alert" });
  const open = async (event) => {
    event.preventDefault();
    const answer = await fetch("/api/login", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ token: field.value }) });
    if (answer.ok) show();
    else say(note, T.wrongToken);
  };
  main.replaceChildren(el("form", { className: "row", onsubmit: open }, el("p", {}, T.needToken), el("label", {}, T.token, field), el("button", { className: "main" }, T.logIn), note));
  field.focus();
}

function navigation(name, drive) {
  const chosen = drive || state?.drives[0]?.name || "";
  const links = [["", T.views.overview, "#/"]];
  if (chosen) for (const part of ["drive", "compare", "life"]) links.push([part, T.views[part], `#/${part}/${encodeURIComponent(chosen)}`]);
  links.push(["events", T.views.events, "#/events"], ["status", T.views.status, "/status"]);
  const nodes = links.map(([part, text, href]) => el("a", { href, ...(part === name ? { "aria-current": "page" } : {}) }, text));
  document.getElementById("nav").replaceChildren(...nodes);
  document.title = [chosen && name ? chosen : "", name ? T.views[name] : "", state?.gateway ?? "edge-daemon"].filter(Boolean).join(" · ");
}

function listen(drive) {
  if (stream && streamOf === drive && stream.readyState !== EventSource.CLOSED) return;
  stream?.close();
  streamOf = drive;
  stream = new EventSource(`/api/live?drive=${encodeURIComponent(drive)}`);
  stream.addEventListener("state", (event) => {
    const first = !state;
    const before = state?.up_s ?? 0;
    state = JSON.parse(event.data);
    heard = Date.now();
    contact.hidden = true;
    if (state.up_s < before) sessionOf(true).catch(() => {});
    say(document.getElementById("title"), T.title(state.gateway, state.site));
    say(document.getElementById("now"), T.now(state.version, T.ago(state.up_s)));
    if (first) navigation(route().name, route().drive);
    view?.state?.(state);
  });
  stream.addEventListener("drive", (event) => view?.drive?.(JSON.parse(event.data)));
}

setInterval(() => {
  const silent = Date.now() - heard;
  if (silent < SILENT_MS || !view) return;
  say(contact, T.lost(Math.round(silent / 1000)));
  contact.hidden = false;
  if (stream?.readyState === EventSource.CLOSED) listen(route().drive);
}, 1000);

addEventListener("hashchange", () => {
  if (location.hash === "#main") return;
  show();
  main.focus();
});
show();

