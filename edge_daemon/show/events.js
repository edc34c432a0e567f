// What happened, newest first; alarms are acknowledged where they stand, at their drive.
import { T, cards, clock, el, getJson, mood, save } from "./dom.js";

const STEP = 100;
const MOST = 500;

export class EventsView {
  constructor() {
    this.rows = [];
    this.most = STEP;
    this.list = el("div", { id: "events" }, el("p", { className: "quiet" }, T.waiting));
    this.node = el("div", {}, el("h2", {}, T.views.events), el("div", { className: "tools" }, el("button", { type: "button", onclick: () => this.saveCsv() }, T.csv)), this.list);
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

  state({ events }) {
    const known = this.rows[0]?.time_s ?? -1;
    const fresh = events.filter((row) => row.time_s > known);
    if (!fresh.length) return;
    this.rows = [...fresh, ...this.rows].slice(0, MOST);
    this.show();
  }

  show() {
    const drive = (row) => (row.drive ? el("a", { href: `#/drive/${encodeURIComponent(row.drive)}` }, row.drive) : "–");
    const older = this.rows.length - this.most;
    const more = el("button", { type: "button", id: "more", onclick: () => this.longer() }, T.more(Math.min(older, STEP)));
    this.list.replaceChildren(cards(T.eventsHead, this.rows.slice(0, this.most).map((row) => [clock(row.time_s), drive(row), { text: T.severity[row.rank], mood: mood(row.rank) }, row.source, row.message])), ...(older > 0 ? [more] : []));
  }

  longer() {
    this.most += STEP;
    this.show();
  }

  saveCsv() {
    const quoted = (value) => `"${String(value).replaceAll('"', '""')}"`;
    const rows = this.rows.map((row) => [clock(row.time_s), row.drive, T.severity[row.rank], row.source, row.message]);
    save("events.csv", [T.eventsHead, ...rows].map((row) => row.map(quoted).join(",")).join("\r\n") + "\r\n");
  }

  close() {}
}
