// What happened, newest first, a trouble and its end in one line; alarms are acknowledged where they stand, at their drive.
import { T, cards, clock, el, getJson, mood, save } from "./dom.js";

const STEP = 100;
const MOST = 500;
const AGAIN_S = 600; // what comes back sooner is the same trouble (guess)
const ENDS = /^(cleared|no longer): /;
const E = T.events;

/**
 * Events of one trouble as one row: `{begin_s, end_s, drive, rank, source, message, times}`; `end_s` is null while it lasts.
 * A trouble is told by its drive, who tells it, and its words without numbers, since those change while it lasts.
 */
export function grouped(events) {
  const rows = [];
  const open = new Map();
  for (const row of events.toReversed()) {
    const ends = ENDS.test(row.message) || / no longer: /.test(row.message);
    const words = row.message.replace(/(cleared|no longer): /, "").replace(/ \(again\)$/, "");
    const key = [row.drive, row.source, words.replace(/[-+]?\d[\d.e+-]*/g, "#")].join("|");
    const known = open.get(key);
    if (ends && known) known.end_s = row.time_s;
    else if (row.rank > 0 && known && (known.end_s === null || row.time_s - known.end_s < AGAIN_S)) {
      Object.assign(known, { message: words, rank: Math.max(known.rank, row.rank), end_s: null, times: known.times + 1 });
    } else {
      const begun = { begin_s: row.time_s, end_s: row.rank > 0 ? null : row.time_s, drive: row.drive, rank: row.rank, source: row.source, message: row.message, times: 1 };
      rows.push(begun);
      if (row.rank > 0) open.set(key, begun);
    }
  }
  return rows.reverse();
}

export class EventsView {
  constructor() {
    this.rows = [];
    this.most = STEP;
    this.drive = el("select", { id: "of-drive", onchange: () => this.show() }, el("option", { value: "" }, E.all));
    this.least = el("select", { id: "severity", onchange: () => this.show() }, ...E.least.map((text, rank) => el("option", { value: rank }, text)));
    this.list = el("div", { id: "events" }, el("p", { className: "quiet" }, T.waiting));
    const filters = el("div", { className: "row" }, el("label", {}, T.drive, this.drive), el("label", {}, E.severity, this.least), el("button", { type: "button", onclick: () => this.saveCsv() }, T.csv));
    this.node = el("div", {}, el("h2", {}, T.views.events), filters, this.list);
    this.load();
  }

  async load() {
    try {
      this.rows = (await getJson("/api/events")).events;
    } catch {
      return; // the newest arrive with the stream
    }
    this.show();
  }

  state({ events, drives }) {
    const names = drives.map((row) => row.name).sort();
    if (this.drive.options.length !== names.length + 1) this.drive.replaceChildren(el("option", { value: "" }, E.all), ...names.map((name) => el("option", { value: name }, name)));
    const known = this.rows[0]?.time_s ?? -1;
    const fresh = events.filter((row) => row.time_s > known);
    if (!fresh.length) return;
    this.rows = [...fresh, ...this.rows].slice(0, MOST);
    this.show();
  }

  get chosen() {
    const [drive, least] = [this.drive.value, Number(this.least.value)];
    return grouped(this.rows).filter((row) => (!drive || row.drive === drive) && row.rank >= least);
  }

  show() {
    const found = this.chosen;
    const drive = (row) => (row.drive ? el("a", { href: `#/drive/${encodeURIComponent(row.drive)}` }, row.drive) : "–");
    const older = found.length - this.most;
    const more = el("button", { type: "button", id: "more", onclick: () => this.longer() }, T.more(Math.min(older, STEP)));
    const rows = found.slice(0, this.most).map((row) => [clock(row.begin_s), row.end_s === null ? E.lasts : row.rank ? clock(row.end_s) : "", row.rank ? lasted(row) : "", drive(row), { text: T.severity[row.rank], mood: row.rank ? mood(row.rank) : "" }, row.source, row.times > 1 ? `${row.message} (${E.times(row.times)})` : row.message]);
    this.list.replaceChildren(rows.length ? cards(T.eventsHead, rows) : el("p", { className: "quiet" }, E.none), ...(older > 0 ? [more] : []));
  }

  longer() {
    this.most += STEP;
    this.show();
  }

  saveCsv() {
    const quoted = (value) => `"${String(value).replaceAll('"', '""')}"`;
    const rows = this.chosen.map((row) => [clock(row.begin_s), row.end_s === null ? "" : clock(row.end_s), lasted(row), row.drive, T.severity[row.rank], row.source, row.message]);
    save("events.csv", [T.eventsHead, ...rows].map((row) => row.map(quoted).join(",")).join("\r\n") + "\r\n");
  }

  close() {}
}

const lasted = (row) => (row.end_s === null ? "" : T.ago(row.end_s - row.begin_s));
