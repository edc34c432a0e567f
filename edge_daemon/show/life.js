// Consumption so far, and what another load would mean.
import { T, digits, el, getJson, percent, say, table } from "./dom.js";

const L = T.lifeView;

export class LifeView {
  constructor(drive) {
    this.name = drive;
    this.facts = el("div");
    this.factor = el("input", { id: "factor", type: "number", min: 0.2, max: 3, step: 0.05, value: 1.2, required: true });
    this.answer = el("div", { id: "answer", role: "status" });
    const form = el("form", { className: "row", onsubmit: (event) => this.ask(event) }, el("label", {}, L.factor, this.factor), el("button", { className: "main", id: "ask" }, L.ask));
    this.node = el("div", {}, el("h2", {}, L.heading(drive)), this.facts, form, this.answer);
  }

  drive({ estimates, picture }) {
    const value = (name) => estimates[name]?.value ?? null;
    const life = T.life(value("rul_p10_h") === null ? null : digits(value("rul_p10_h")), digits(value("rul_p90_h")));
    const rows = [[L.gear, picture?.gear ?? "–"], [L.used, `${percent(value("damage"))} %`], [L.observed, digits(picture?.observed_h ?? null)], [T.plot.life, life]];
    const text = JSON.stringify(rows);
    if (text === this.shown) return;
    this.shown = text;
    this.facts.replaceChildren(table(["", ""], rows));
  }

  async ask(event) {
    event.preventDefault();
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
