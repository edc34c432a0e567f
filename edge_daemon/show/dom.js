// Small helpers: elements, numbers, requests.
import { T } from "./texts.js";

export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (name in node && name !== "list") node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children.filter((child) => child !== null));
  return node;
}

/** Replaces the text only if it differs: a screen reader and a selection are left alone. */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function table(head, rows) {
  const cell = (tag, value) => (value instanceof Node ? el(tag, {}, value) : el(tag, value?.mood ? { className: value.mood } : {}, String(value?.text ?? value)));
  const body = rows.map((row) => el("tr", { role: "row" }, ...row.map((value, i) => named(cell(i ? "td" : "th", value), i, head))));
  const top = el("tr", { role: "row" }, ...head.map((name) => el("th", { scope: "col", role: "columnheader" }, name)));
  const parts = [el("thead", { role: "rowgroup" }, top), el("tbody", { role: "rowgroup" }, ...body)];
  return el("div", { className: "scroll" }, el("table", { role: "table" }, ...parts));
}

/** A table whose rows become cards on a phone. */
export function cards(head, rows) {
  const node = table(head, rows);
  node.classList.add("cards");
  return node;
}

/** A cell that says which column it is of, for where a row is shown as a card; the roles stay whatever the layout. */
function named(cell, i, head) {
  cell.setAttribute("role", i ? "cell" : "rowheader");
  if (!i) cell.setAttribute("scope", "row");
  if (head[i]) cell.dataset.head = head[i];
  return cell;
}

export const digits = (value, n = 3) => (value === null || value === undefined ? "–" : Number(value.toPrecision(n)).toString());
export const percent = (value, n = 3) => (value === null || value === undefined ? "–" : digits(100 * value, n));
export const clock = (time_s) => new Date(1000 * time_s).toISOString().slice(0, 19).replace("T", " ");

/** Value and sd to two digits of the sd; with an exponent where both are tiny, or either is huge. */
export function withSd(value, sd) {
  if (value === null || value === undefined) return ["–", ""];
  if (!(sd > 0)) return [digits(value, 6), ""];
  const places = 1 - Math.floor(Math.log10(sd));
  const size = Math.max(Math.abs(value), sd);
  if (size >= 1e6 || size < 1e-3) {
    const shown = places + Math.floor(Math.log10(Math.abs(value) || sd));
    return [value.toExponential(Math.max(0, Math.min(shown, 9))), sd.toExponential(1)];
  }
  const shown = Math.max(0, Math.min(places, 9));
  return [value.toFixed(shown).replace(/^-(0\.?0*)$/, "$1"), sd.toFixed(shown)];
}

export const mood = (rank) => (rank === 0 ? "good" : rank < 3 ? "warn" : "bad");

let session = null;

export async function getJson(path) {
  const answer = await fetch(path, { signal: AbortSignal.timeout(15000) });
  if (answer.status === 401) throw new NeedToken();
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer.json();
}

export class NeedToken extends Error {}

/** What the page may do; asked for again after a restart of the daemon, whose secret is then another. */
export async function sessionOf(fresh = false) {
  if (fresh || !session) session = await getJson("/api/session");
  return session;
}

export async function post(path, body, again = true) {
  const { header, secret } = await sessionOf();
  const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json", [header]: secret }, body: JSON.stringify(body) });
  if (answer.status === 401) throw new NeedToken();
  if (answer.status === 403 && again && (await sessionOf(true)).secret !== secret) return post(path, body, false);
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer.json();
}

/** Sends a file as it is. */
export async function upload(file) {
  const { header, secret } = await sessionOf(true);
  const answer = await fetch(`/api/upload?name=${encodeURIComponent(file.name)}`, { method: "POST", headers: { "Content-Type": "application/octet-stream", [header]: secret }, body: file });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer.json();
}

/** Lets the browser save what stands at an address of the gateway. */
export const download = (href) => el("a", { href, download: "" }).click();

export function save(name, text) {
  const address = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  el("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

export { T };
