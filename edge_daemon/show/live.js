// Overview of all drives, and one drive live.
import { T, digits, el, getJson, mood, percent, post, say, table, withSd } from "./dom.js";
import { Plot } from "./plots.js";

const ARC_MIN = (180 * 60) / Math.PI;
const TRENDS = ["stiffness", "ratio", "rul_p10_h", "rul_p50_h", "rul_p90_h", "model_nrmse", "model_noise_floor", "torque_rms", "torque_peak", "health_index"];
const TREND_POINTS = 400;
const TREND_EVERY_MS = 5000;

/** What is wrong and what to do: the daemon's sentences have the advice after their last colon. */
export function adviceOf(reason) {
  const at = reason.lastIndexOf(": ");
  return at < 0 ? [reason, ""] : [reason.slice(0, at), reason.slice(at + 2)];
}

export class Overview {
  constructor() {
    this.node = el("div", { id: "overview" });
    this.rows = "";
  }

  state(state) {
    const rows = state.drives.map((row) => [
      el("a", { href: `#/drive/${encodeURIComponent(row.name)}` }, row.name),
      { text: T.state[row.state] ?? row.state, mood: mood(row.rank) },
      row.reasons[0] ?? "",
      percentOf(row.health_index),
      digits(row.rul_p10_h),
      digits(row.stiffness, 4),
      percent(row.model_nrmse),
    ]);
    const text = JSON.stringify([state.drives.map((row) => [row.name, row.state, row.reasons[0]]), state.troubles]);
    if (text === this.rows) {
      this.refresh(rows);
      return;
    }
    this.rows = text;
    this.table = table(T.overviewHead, rows);
    const troubles = state.troubles.map((line) => el("p", { className: "warn" }, line));
    this.node.replaceChildren(this.table, ...(troubles.length ? [el("h2", {}, T.troubles), ...troubles] : []));
  }

  /** Only the numbers, in place: a link keeps its focus. */
  refresh(rows) {
    const lines = this.table.querySelectorAll("tbody tr");
    rows.forEach((row, i) => row.slice(3).forEach((value, k) => say(lines[i].cells[k + 3], value)));
  }

  close() {}
}

const percentOf = (value) => (value === null ? "–" : `${Math.round(100 * value)} %`);

export class DriveView {
  constructor(drive, session) {
    this.name = drive;
    this.session = session;
    this.baseline = null;
    this.span_s = 600;
    this.status = el("div", { className: "state", role: "status" }, el("b", {}, T.waiting));
    this.plots = this.makePlots();
    this.numbers = el("div");
    const choice = el("select", { id: "span", onchange: () => this.choose(Number(choice.value)) }, ...Object.entries(T.spans).map(([s, text]) => el("option", { value: s }, text)));
    const live = ["noise", "loop", "load", "error"].map((name) => this.plots[name].node);
    const trends = ["stiffness", "life", "ratio", "torque"].map((name) => this.plots[name].node);
    this.node = el("div", {}, el("h2", {}, drive), this.status, window.uPlot ? null : el("p", { className: "warn" }, T.noCharts),
      el("div", { className: "row" }, el("label", {}, T.span, choice)),
      el("div", { className: "plots" }, ...live, ...trends), el("h2", {}, T.numbers), this.numbers);
    this.trend();
    this.timer = setInterval(() => this.trend(), TREND_EVERY_MS);
    this.loadBaseline();
  }

  makePlots() {
    const { axis, plot, line } = T;
    const trend = (id, y, lines, more = {}) => new Plot(plot[id], { id, x: axis.time, y, lines, time: true, ...more });
    return {
      noise: new Plot(plot.noise, { id: "noise", x: axis.frequency, y: axis.psd, lines: [line.measured, line.fit, line.baseline], logX: true, logY: true }),
      loop: new Plot(plot.loop, { id: "loop", x: axis.twist, y: axis.torque, lines: [line.measured, line.slope, line.low, line.high, line.maker], xy: true }),
      load: new Plot(plot.load, { id: "load", x: axis.range, y: axis.cycles, lines: [line.cycles], bars: true }),
      error: trend("error", axis.error, [line.error, line.floor]),
      stiffness: trend("stiffness", axis.stiffness, [line.value, line.high, line.low], { band: [1, 2] }),
      life: trend("life", axis.life, [line.p50, line.p90, line.p10], { band: [1, 2] }),
      ratio: trend("ratio", axis.ratio, [line.value, line.high, line.low], { band: [1, 2] }),
      torque: trend("torque", axis.torque, [line.rms, line.peak]),
    };
  }

  choose(span_s) {
    this.span_s = span_s;
    this.trend();
  }

  state(state) {
    if (state.drives.some((row) => row.name === this.name)) return;
    this.status.className = "state bad";
    this.status.replaceChildren(el("b", {}, T.noDrive(this.name)));
    this.shown = ""; // it may come back just as it was
  }

  drive(news) {
    if (news.name !== this.name) return;
    this.news = news;
    this.showStatus(news);
    this.showNumbers(news.estimates);
    const { picture, estimates } = news;
    if (!picture) return;
    this.showNoise(picture.noise);
    this.showLoop(picture.loop, estimates.stiffness);
    this.showLoad(picture.load);
  }

  showStatus(news) {
    const text = JSON.stringify([news.stale, news.state, news.reasons]);
    if (text === this.shown) return;
    this.shown = text;
    const state = news.stale ? "no data" : news.state.replaceAll("_", " ");
    this.status.className = `state ${mood(news.stale ? 5 : news.ne107)}`;
    const rows = news.reasons.map(adviceOf);
    const lines = rows.map(([why, todo]) => el("p", {}, `${T.why}: ${why}. ${T.todo}: ${todo || T.checkSource}.`));
    if (!lines.length) lines.push(el("p", {}, news.stale ? T.checkSource : T.nothing));
    const button = el("button", { type: "button", disabled: !this.session.allow_changes, title: this.session.allow_changes ? "" : T.changesOff, onclick: () => this.acknowledge() }, T.acknowledge);
    this.status.replaceChildren(el("b", {}, T.state[state] ?? state), ...lines, ...(rows.length ? [button] : []));
  }

  async acknowledge() {
    try {
      const { acknowledged } = await post("/api/acknowledge", { drive: this.name });
      this.status.append(el("p", {}, T.acknowledged(acknowledged)));
    } catch (error) {
      this.status.append(el("p", { className: "bad" }, error.message));
    }
  }

  showNumbers(estimates) {
    const rows = Object.entries(this.session.quantities).map(([name, { unit, meaning }]) => {
      const row = estimates[name];
      return [name.replaceAll("_", " "), ...withSd(row?.value, row?.sd), unit === "1" ? "" : unit, row ? T.status[row.status] : "–", meaning];
    });
    if (!this.table) {
      this.table = table(T.numbersHead, rows);
      this.numbers.replaceChildren(this.table);
      return;
    }
    const lines = this.table.querySelectorAll("tbody tr");
    rows.forEach((row, i) => row.forEach((value, k) => say(lines[i].cells[k], value)));
  }

  showNoise(noise) {
    if (!noise) {
      this.plots.noise.set([[1], [null], [null], [null]], T.noNoise);
      return;
    }
    const blank = noise.frequency_hz.map(() => null);
    const base = this.baseline ? noise.frequency_hz.map((f) => sumOf(this.baseline, f / (noise.reference_hz ?? 300))) : blank;
    const positive = (values) => (values ?? blank).map((value) => (value > 0 ? value : null));
    const data = [noise.frequency_hz, positive(noise.psd), positive(noise.fit), positive(base)];
    let verdict = T.noise(Math.round(noise.averages), noise.tones.length);
    verdict += this.baseline && noise.fit ? T.noiseChange(10 * Math.log10(power(noise.frequency_hz, noise.fit) / power(noise.frequency_hz, base))) : ".";
    this.plots.noise.set(data, verdict);
  }

  /** The noise of the first stored hour, from its coefficients. */
  async loadBaseline() {
    const names = [0, 1, 2, 3, 4].map((n) => `noise_a${n}`);
    try {
      const { rows } = await getJson(`/api/history?drive=${encodeURIComponent(this.name)}&names=${names}&limit=50`);
      const first = names.map((name) => rows.find((row) => row.name === name && row.value !== null)?.value);
      const oldest = rows[0]?.time_s ?? Infinity;
      if (first.every((value) => value !== undefined) && Date.now() / 1000 - oldest > 3600) this.baseline = first;
    } catch {
      this.baseline = null;
    }
  }

  showLoop(loop, stiffness) {
    const none = [[], []];
    if (!loop) {
      this.plots.loop.set([none, none, none, none, none], T.loopWaiting);
      return;
    }
    const twist = loop.twist_rad.map((value) => (value === null ? null : value * ARC_MIN));
    const known = loop.twist_rad.filter((value) => value !== null);
    const reach = known.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    const line = (k) => (k === null || k === undefined || !reach ? none : [[-reach * ARC_MIN, reach * ARC_MIN], [-k * reach, k * reach]]);
    const { value = null, sd = 0 } = stiffness ?? {};
    this.plots.loop.set([[twist, loop.torque_Nm], line(value), line(value === null ? null : value - 2 * sd), line(value === null ? null : value + 2 * sd), makers(loop.maker, reach)],
      value === null ? T.loopUnknown : T.loop(...withSd(value, sd)));
  }

  showLoad(load) {
    if (!load) {
      this.plots.load.set([[0, 1], [null, null]], T.noLoad);
      return;
    }
    const limit = load.limits.find(([, torque]) => torque > load.peak_Nm) ?? load.limits.at(-1);
    this.plots.load.set([load.range_Nm, load.cycles], T.load(digits(load.peak_Nm), limit));
  }

  async trend() {
    const since_s = Date.now() / 1000 - this.span_s;
    const query = `drive=${encodeURIComponent(this.name)}&names=${TRENDS}&since_s=${since_s}&limit=${TREND_POINTS * TRENDS.length}`;
    try {
      const { rows } = await getJson(`/api/history?${query}`);
      this.showTrends(columnsOf(rows, Math.max(2, this.span_s / TREND_POINTS)));
    } catch {
      return; // the stream says that the gateway is away
    }
  }

  showTrends({ time, value, sd }) {
    const now = (name) => this.news?.estimates[name]?.value ?? null;
    const around = (name) => {
      const at = value(name);
      const by = sd(name);
      const shifted = (sign) => at.map((v, i) => (v === null ? null : v + 2 * sign * (by[i] ?? 0)));
      return [time, at, shifted(1), shifted(-1)];
    };
    const parts = (name) => value(name).map((v) => (v === null ? null : 100 * v));
    const words = (text) => (time.length ? text : T.trendEmpty);
    const [ratio] = withSd(now("ratio"), this.news?.estimates.ratio?.sd);
    this.plots.stiffness.set(around("stiffness"), words(T.stiffness(now("stiffness_change"))));
    this.plots.ratio.set(around("ratio"), words(T.ratio(now("ratio") === null ? null : ratio, now("ratcheting_events"))));
    this.plots.life.set([time, value("rul_p50_h"), value("rul_p90_h"), value("rul_p10_h")], words(T.life(rounded(last(value("rul_p10_h"))), rounded(last(value("rul_p90_h"))), now("rul_p10_h") === null)));
    this.plots.error.set([time, parts("model_nrmse"), parts("model_noise_floor")], words(T.error(hundred(now("model_nrmse")), hundred(now("model_noise_floor")))));
    this.plots.torque.set([time, value("torque_rms"), value("torque_peak")], words(T.torque(rounded(now("torque_rms")), rounded(now("torque_peak")))));
  }

  close() {
    clearInterval(this.timer);
    Object.values(this.plots).forEach((plot) => plot.close());
  }
}

const last = (values) => values.findLast((value) => value !== null) ?? null;
const rounded = (value) => (value === null ? null : Number(value.toPrecision(3)));
const hundred = (value) => (value === null ? null : Number((100 * value).toPrecision(3)));
const sumOf = (coefficients, f) => coefficients.reduce((total, a, beta) => total + a * f ** -beta, 0);

function power(frequency, psd) {
  let total = 0;
  for (let i = 1; i < frequency.length; i++) total += Math.max(psd[i] ?? 0, 0) * (frequency[i] - frequency[i - 1]);
  return total;
}

/** The maker's corners to both sides of zero, as far as the gear is twisted now. */
function makers(corners, reach_rad) {
  if (!corners || !reach_rad) return [[], []];
  const side = [];
  for (let i = 1; i < corners.length; i++) {
    const [from, to] = [corners[i - 1], corners[i]];
    const share = Math.min(1, (reach_rad - from[0]) / (to[0] - from[0]));
    side.push([from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]);
    if (share < 1) break;
  }
  const all = [...side.map(([x, y]) => [-x, -y]).reverse(), [0, 0], ...side];
  return [all.map(([x]) => x * ARC_MIN), all.map(([, y]) => y)];
}

/** Rows of one estimate each as columns over common times, `width_s` apart. */
function columnsOf(rows, width_s) {
  const byName = {};
  const usable = (row) => row.status === "valid" || row.status === "not_excited" || row.name.startsWith("rul");
  const known = rows.filter((row) => row.time_s !== null);
  const at = (row) => Math.floor(row.time_s / width_s);
  for (const row of known) (byName[row.name] ??= new Map()).set(at(row), usable(row) ? row : null);
  const steps = [...new Set(known.map(at))].sort((a, b) => a - b);
  const usual = steps.slice(1).map((step, i) => step - steps[i]).sort((a, b) => a - b)[steps.length >> 1] ?? 1;
  // an instant without a value where nothing was stored for long, so that no line bridges it
  const shown = steps.flatMap((step, i) => (i && step - steps[i - 1] > 5 * usual ? [step - 1, step] : [step]));
  const one = (name, step, field) => byName[name]?.get(step)?.[field] ?? byName[name]?.get(step - 1)?.[field] ?? null;
  const stored = new Set(steps);
  const column = (field) => (name) => shown.map((step) => (stored.has(step) ? one(name, step, field) : null));
  return { time: shown.map((step) => step * width_s), value: column("value"), sd: column("sd") };
}


