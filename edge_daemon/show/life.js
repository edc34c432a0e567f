// Consumption so far, and what another load would mean.
import { T, digits, el, getJson, percent, say, table } from "./dom.js";

const L = T.lifeView;

export class LifeView {
  constructor(drive) {
    this.name = drive;
    this.facts = el("div");
    this.factor = el("input", { id: "factor", type: "number", min: 0.2, max: 3, step: 0.05, value: 1, required: true });
    this.answer = el("div", { id: "answer", role: "status" });
    const form = el("form", { className: "row", onsubmit: (event) => this.ask(event) }, el("label", {}, L.factor, this.factor), el("button", { className: "main", id: "ask" }, L.ask));
    this.node = el("div", {}, el("h2", {}, L.heading(drive)), this.facts, form, this.answer);
    this.ask();
  }

  drive({ estimates, picture }) {
    const value = (name) => estimates[name]?.value ?? null;
    const used = value("damage") === null ? T.status[estimates.damage?.status ?? "invalid"] : `${percent(value("damage"))} %`;
    const rows = [[L.gear, picture?.gear ?? "–"], [L.used, used], [L.observed, digits(picture?.observed_h ?? null)]];
    const text = JSON.stringify(rows);
    if (text === this.shown) return;
    this.shown = text;
    this.facts.replaceChildren(table(["", ""], rows));
  }

  async ask(event) {
    event?.preventDefault();
    try {
      const found = await getJson(`/api/what-if?drive=${encodeURIComponent(this.name)}&factor=${this.factor.value}`);
      const rows = found.failure_probability.map((row) => [row.within_h, percent(row.probability)]);
      const { p10, p50, p90 } = found.rul_h;
      this.answer.replaceChildren(el("p", { className: "verdict" }, L.answer(found.factor, digits(p10), digits(p50), digits(p90), found.basis)), table([L.within, L.probability], rows));
    } catch (error) {
      say(this.answer, error.message);
    }
  }

  close() {}
}
