// Consumption so far, and what another load would mean.
import { T, digits, el, getJson, percent, say, table } from "./dom.js";
import { Plot } from "./plots.js";

const L = T.lifeView;
const TRENDS = ["damage", "health_index"];
const TREND_POINTS = 300;

export class LifeView {
  constructor(drive, session, [span] = []) {
    this.name = drive;
    this.span_s = span in T.spans ? Number(span) : 2592000;
    this.ahead_s = 0;
    this.facts = el("div");
    this.factor = el("input", { id: "factor", type: "number", min: 0.2, max: 3, step: 0.05, value: 1, required: true });
    this.answer = el("div", { id: "answer", role: "status" });
    const form = el("form", { className: "row", onsubmit: (event) => this.ask(event) }, el("label", {}, L.factor, this.factor), el("button", { className: "main", id: "ask" }, L.ask));
    this.chance = new Plot(T.plot.chance, { id: "chance", x: T.axis.ahead, y: T.axis.chance, lines: [L.asSoFar, L.asked] });
    this.used = new Plot(T.plot.used, { id: "used", x: T.axis.time, y: T.axis.used, lines: [T.line.damage, T.line.health], time: true });
    const choice = el("select", { id: "span", onchange: () => this.trend(Number(choice.value)) }, ...Object.entries(T.spans).map(([s, text]) => el("option", { value: s, selected: Number(s) === this.span_s }, text)));
    this.node = el("div", {}, el("h2", {}, L.heading(drive)), this.facts, el("h2", {}, L.ask), form, this.answer, el("div", { className: "plots" }, this.chance.node),
      el("div", { className: "row over" }, el("h2", {}, T.trends), el("label", {}, T.span, choice)), el("div", { className: "plots" }, this.used.node));
    this.trend(this.span_s);
  }

  state(state) {
    this.ahead_s = state.now_s - Date.now() / 1000;
  }

  drive({ estimates, picture }) {
    if (!this.begun && picture) {
      this.begun = true;
      this.begin(picture.gear);
    }
    const value = (name) => estimates[name]?.value ?? null;
    const used = value("damage") === null ? L.notYet : `${percent(value("damage"))} %`;
    const rows = [[L.gear, picture?.gear ?? L.noGear], [L.used, used], [L.observed, digits(picture?.observed_h ?? null)], [L.counted, picture?.counted || L.noGear]];
    const text = JSON.stringify(rows);
    if (text === this.shown) return;
    this.shown = text;
    this.facts.replaceChildren(el("dl", {}, ...rows.flatMap(([name, what]) => [el("dt", {}, name), el("dd", {}, what)])));
  }

  /** Without a gear there is nothing to ask. */
  begin(gear) {
    if (gear) this.ask();
    else {
      this.chance.empty(L.noChance);
      this.node.querySelectorAll("form *").forEach((part) => (part.disabled = true));
    }
  }

  async ask(event) {
    event?.preventDefault();
    const path = (factor) => `/api/what-if?drive=${encodeURIComponent(this.name)}&factor=${factor}`;
    try {
      const found = await getJson(path(this.factor.value));
      this.asSoFar ??= found.factor === 1 ? found : await getJson(path(1));
      this.show(found);
    } catch (error) {
      say(this.answer, error.message);
      this.chance.empty(L.noChance);
    }
  }

  show(found) {
    const rows = found.failure_probability.map((row) => [T.horizon(row.within_h), percent(row.probability)]);
    const { p10, p50, p90 } = found.rul_h;
    const verdict = L.answer(found.factor, digits(p10), digits(p50), digits(p90), L.basis[found.basis]);
    this.answer.replaceChildren(el("p", { className: "verdict" }, verdict), table([L.within, L.probability], rows));
    this.chance.set(joined(this.asSoFar.curve, found.factor === 1 ? null : found.curve), L.half(digits(p50)));
  }

  async trend(span_s) {
    const until_s = Date.now() / 1000 + this.ahead_s;
    const query = `drive=${encodeURIComponent(this.name)}&names=${TRENDS}&since_s=${until_s - span_s}&until_s=${until_s}&points=${TREND_POINTS}`;
    try {
      const { time_s, value } = await getJson(`/api/trend?${query}`);
      const parts = TRENDS.map((name) => value[name].map((v) => (v === null ? null : 100 * v)));
      const known = parts.map((row) => row.filter((v) => v !== null));
      if (known.some((row) => row.length)) this.used.set([time_s, ...parts], L.usedIn(T.spans[span_s], grown(known[0]), digits(known[1].at(-1) ?? null, 3)), [until_s - span_s, until_s]);
      else this.used.empty(T.trendEmpty);
    } catch (error) {
      this.used.empty(error.message);
    }
  }

  close() {
    this.chance.close();
    this.used.close();
  }
}

const grown = (values) => (values.length ? digits(values.at(-1) - values[0], 2) : null);

/** Two curves over different hours as columns over common ones. */
function joined(one, other) {
  const hours = [...new Set([...one.within_h, ...(other?.within_h ?? [])])].sort((a, b) => a - b);
  const column = (curve) => hours.map((h) => (curve ? at(curve, h) : null));
  return [hours, column(one), column(other)];
}

/** Probability [%] at an hour, between two known ones; null beyond the curve. */
function at({ within_h, probability }, h) {
  const i = within_h.findIndex((known) => known >= h);
  if (i < 0) return null;
  if (within_h[i] === h || i === 0) return 100 * probability[i];
  const share = (h - within_h[i - 1]) / (within_h[i] - within_h[i - 1]);
  return 100 * (probability[i - 1] + share * (probability[i] - probability[i - 1]));
}
