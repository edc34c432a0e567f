// One drive: what is wrong, why and what to do; then the four questions; then the plots; the rest folded.
import { T, cards, clock, digits, el, getJson, mood, percent, post, say, withSd } from "./dom.js";
import { bars, range, ratio, spark } from "./gauges.js";
import { FAIR, adviceOf } from "./overview.js";
import { Plot } from "./plots.js";

const ARC_MIN = (180 * 60) / Math.PI;
const TRENDS = ["stiffness", "ratio", "rul_p10_h", "rul_p50_h", "rul_p90_h", "model_nrmse", "model_noise_floor", "torque_rms", "torque_peak", "noise_rms"];
const TREND_POINTS = 300;
const TREND_EVERY_MS = [5000, 300000];
const WHO = "edge-daemon who";
const MARKS = 12;
const Q = T.questions;

export class DriveView {
  constructor(drive, session, [span] = []) {
    this.name = drive;
    this.session = session;
    this.span_s = span in T.spans ? Number(span) : 600;
    this.status = el("div", { className: "state", role: "status" }, el("b", {}, T.waiting));
    this.who = el("input", { id: "who", maxLength: 40, autocomplete: "name", value: localStorage.getItem(WHO) ?? "", onchange: () => localStorage.setItem(WHO, this.who.value) });
    this.plots = this.makePlots();
    this.numbers = el("div", { className: "numbers" });
    this.ahead_s = 0; // of the gateway's clock before the browser's
    const choice = el("select", { id: "span", onchange: () => this.choose(Number(choice.value)) }, ...Object.entries(T.spans).map(([s, text]) => el("option", { value: s, selected: Number(s) === this.span_s }, text)));
    const nodes = (...names) => el("div", { className: "plots" }, ...names.map((name) => this.plots[name].node));
    this.questions = Object.fromEntries(["now", "life", "right", "missing"].map((name) => [name, this.question(name)]));
    this.more = el("details", { id: "more" }, el("summary", {}, T.morePlots), nodes("error", "life", "noise", "load", "torque", "ratio", "level"));
    this.sound = el("details", { id: "sound" }, el("summary", {}, T.soundView.title));
    this.sound.addEventListener("toggle", () => this.hear());
    this.all = el("details", { id: "all" }, el("summary", {}, T.allNumbers(Object.keys(session.quantities).length)), this.numbers);
    this.node = el("div", { className: "drive" }, el("h2", { className: "only-print" }, drive), this.status, window.uPlot ? null : el("p", { className: "warn" }, T.noCharts),
      el("div", { className: "questions" }, ...Object.values(this.questions).map((row) => row.node)),
      el("div", { className: "row over" }, el("h2", {}, T.closer), el("label", {}, T.span, choice)), nodes("loop", "stiffness"), this.more, this.sound, this.all);
    this.marks = [];
    this.trend();
    this.happened();
    this.lastLook();
  }

  /** A question of four: a large number, a small picture, and a line of words. */
  question(name) {
    const parts = { big: el("p", { className: "big" }, "–"), picture: el("div"), words: el("p", { className: "quiet" }), act: el("p") };
    return { ...parts, node: el("section", { className: "question", id: `question-${name}` }, el("h2", {}, Q[name]), parts.big, parts.picture, parts.words, parts.act) };
  }

  ask(name, value, unit, picture, words) {
    const part = this.questions[name];
    const shown = [value, unit, words].join("|");
    if (part.shown !== shown || picture) part.picture.replaceChildren(...(picture ? [picture] : []));
    if (part.shown === shown) return;
    part.shown = shown;
    part.big.replaceChildren(value, " ", el("small", {}, unit));
    say(part.words, words);
  }

  /** Times that the model misses more than sensor noise would make; null where that is not known. */
  get times() {
    const { model_nrmse: error, model_noise_floor: floor } = this.news?.estimates ?? {};
    return error?.value && floor?.value ? error.value / floor.value : null;
  }

  showQuestions({ estimates, picture }) {
    const now = (name) => estimates[name]?.value ?? null;
    const past = this.past;
    const stiffness = now("stiffness");
    const [k, sd, unit] = stiffness === null ? ["–", "", ""] : stiff(stiffness, estimates.stiffness.sd);
    const health = now("health_index");
    const change = now("stiffness_change");
    if (picture?.model.balance === "drive") this.ask("now", health === null ? "–" : `${Math.round(100 * health)} %`, T.line.health, null, Q.oneEncoder);
    else this.ask("now", k, stiffness === null ? Q.unknown : `${unit} ± ${sd}`, past ? spark(past.time_s, past.value.stiffness, past.sd.stiffness) : null, Q.nowWords(change, now("ratio"), health));
    const [p10, p50, p90] = [now("rul_p10_h") ?? last(past?.value.rul_p10_h), now("rul_p50_h") ?? last(past?.value.rul_p50_h), now("rul_p90_h") ?? last(past?.value.rul_p90_h)];
    if (p10 === null || p90 === null) this.ask("life", "–", "", null, Q.noLife);
    else this.ask("life", hours(p10), Q.exceed, range(p10, p50, p90, [Q.today, hours(p90)]), Q.lifeWords(hours(p50), now("rul_p10_h") === null));
    this.showModel(now("model_nrmse"), now("model_noise_floor"));
  }

  showModel(error, floor) {
    const times = this.times;
    if (times === null) this.ask("right", "–", "", null, Q.learning);
    else this.ask("right", digits(times, 2), Q.times, ratio(times, FAIR, [Q.noise, `${percent(error, 2)} %`]), Q.rightWords(percent(error, 2), percent(floor, 2)));
    const found = this.look?.diagnose;
    const best = found?.candidates?.[0];
    if (times === null) this.ask("missing", "–", "", null, Q.learning);
    else if (times <= FAIR) this.ask("missing", Q.nothing, "", null, Q.nothingWords);
    else if (best) this.ask("missing", named(best.effect), "", bars(ranked(found.candidates)), Q.missingWords(percent(found.error.nrmse, 2), percent(best.nrmse_after, 2)));
    else this.ask("missing", Q.something, "", null, Q.notAsked);
    const href = `#/compare/${encodeURIComponent(this.name)}${best ? "" : "/find"}`;
    const words = times === null || times <= FAIR ? "" : best ? Q.tryIt : T.find;
    const part = this.questions.missing;
    if (part.act.dataset.words === words) return;
    part.act.dataset.words = words;
    part.act.replaceChildren(...(words ? [el("a", { href, className: "button" }, words)] : []));
  }

  /** What Compare found last of this drive, if it still stands. */
  async lastLook() {
    try {
      const { job } = await getJson("/api/job");
      if (!job || job.running || job.error || job.drive !== this.name || job.kind !== "look") return;
      this.look = (await getJson("/api/result")).result;
      if (this.news) this.showQuestions(this.news);
    } catch {
      return; // nothing was looked for since the daemon began
    }
  }

  /** Restarts, changes of the model and alarms, to be marked on every trend. */
  async happened() {
    try {
      this.noteEvents((await getJson("/api/events")).events);
    } catch {
      return; // the newest come with the stream
    }
  }

  noteEvents(events) {
    const known = new Set(this.marks.map((row) => row.join()));
    const fresh = events.filter((row) => row.drive === this.name).map((row) => marked(row)).filter((row) => row && !known.has(row.join()));
    if (!fresh.length) return;
    this.marks = [...this.marks, ...fresh].sort((a, b) => a[0] - b[0]).slice(-MARKS);
    Object.values(this.plots).forEach((plot) => plot.mark(this.marks));
  }

  makePlots() {
    const { axis, plot, line } = T;
    const trend = (id, y, lines, more = {}) => new Plot(plot[id], { id, x: axis.time, y, lines, time: true, ...more });
    return {
      noise: new Plot(plot.noise, { id: "noise", x: axis.frequency, y: axis.psd, lines: [line.measured, line.fit, line.baseline], logX: true, logY: true }),
      loop: new Plot(plot.loop, { id: "loop", x: axis.twist, y: axis.torque, lines: [line.measured, line.band, line.slope, line.maker], area: 1, curve: 2, xy: true }),
      load: new Plot(plot.load, { id: "load", x: axis.range, y: axis.cycles, lines: [line.cycles], bars: true }),
      error: trend("error", axis.error, [line.error, line.floor]),
      stiffness: trend("stiffness", axis.stiffness, [line.value, line.high, line.low], { band: [1, 2] }),
      life: trend("life", axis.life, [line.p50, line.p90, line.p10], { band: [1, 2] }),
      ratio: trend("ratio", axis.ratio, [line.value, line.high, line.low], { band: [1, 2] }),
      torque: trend("torque", axis.torque, [line.rms, line.peak]),
      level: trend("level", axis.level, [line.value, line.high, line.low], { band: [1, 2] }),
    };
  }

  /** The sound of months is fetched when somebody unfolds it, and so is what draws it. */
  async hear() {
    if (!this.sound.open || this.heard) return;
    const { SoundView } = await import("./sound.js");
    if (this.heard || this.closed) return;
    this.heard = new SoundView(this.name);
    this.sound.append(el("div", { className: "plots" }, this.heard.node));
  }

  choose(span_s) {
    this.span_s = span_s;
    history.replaceState(null, "", `#/drive/${encodeURIComponent(this.name)}/${span_s}`);
    this.trend();
  }

  state(state) {
    this.ahead_s = state.now_s - Date.now() / 1000;
    this.noteEvents(state.events);
    if (state.drives.some((row) => row.name === this.name)) return;
    this.status.className = "state bad";
    this.status.dataset.state = "gone";
    this.status.replaceChildren(el("b", {}, T.noDrive(this.name)));
    this.shown = ""; // it may come back just as it was
  }

  drive(news) {
    if (news.name !== this.name) return;
    const first = !this.news;
    this.news = news;
    if (first && this.past) this.showTrends(this.past);
    this.showStatus(news);
    this.showQuestions(news);
    if (this.all.open || !this.table) this.showNumbers(news.estimates);
    const { picture, estimates } = news;
    if (!picture) return;
    this.showNoise(picture.noise);
    this.showLoop(picture, estimates.stiffness);
    this.showLoad(picture);
  }

  showStatus(news) {
    const alarms = news.picture?.alarms ?? news.reasons.map((text) => ({ text, acknowledged: true }));
    const late = news.stale && !news.starting;
    const state = news.starting ? "starting" : late ? "no data" : news.state.replaceAll("_", " ");
    const lacks = !late && !news.starting && this.times > FAIR;
    const only = lacks && state === "ok";
    const error = lacks ? percent(news.estimates.model_nrmse.value, 2) : "";
    const text = JSON.stringify([state, alarms, error]);
    if (text === this.shown) return;
    this.shown = text;
    this.status.className = `state ${news.starting ? "" : only ? "warn" : mood(late ? 5 : news.ne107)}`;
    this.status.dataset.state = state;
    const lines = alarms.map((alarm) => this.alarm(alarm));
    const k = news.estimates.stiffness;
    if (lacks) lines.push(el("p", {}, T.lacks(error, percent(news.estimates.model_noise_floor.value, 2), k?.value ? percent(k.sd / k.value, 2) : null)));
    else if (!lines.length && state !== "ok") lines.push(el("p", {}, late ? T.noData : news.starting ? T.starting : T.nothing));
    const open = alarms.filter((alarm) => !alarm.acknowledged).length;
    const tools = open ? [el("div", { className: "row" }, el("label", {}, T.who, this.who), open > 1 ? this.button(T.acknowledgeAll(open), null) : null, this.session.allow_changes ? null : el("span", { className: "quiet" }, T.changesOff))] : [];
    this.note = el("p", { className: "bad" });
    const find = lacks ? [el("a", { className: "button main", href: `#/compare/${encodeURIComponent(this.name)}/find` }, T.find)] : [];
    this.status.replaceChildren(el("div", {}, el("span", { className: "quiet" }, this.name), el("b", {}, only ? T.worksBut : (T.headline[state] ?? state)), ...lines, ...tools, this.note), ...find);
  }

  /** One alarm: why, what to do, since when, and whether somebody has seen it. */
  alarm(alarm) {
    const [why, todo] = adviceOf(alarm.text);
    const since = alarm.since_s ? ` ${T.since(clock(alarm.since_s), alarm.gone, alarm.acknowledged)}` : "";
    const text = el("p", {}, el("span", { className: "quiet" }, `${T.why}: `), `${why}. `, el("span", { className: "quiet" }, `${T.todo}: `), el("strong", {}, `${todo || T.checkSource}.`), el("span", { className: "quiet" }, since));
    return el("div", { className: "alarm" }, text, alarm.acknowledged ? null : this.button(T.acknowledge, alarm.key, alarm.text));
  }

  button(text, key, of = "") {
    return el("button", { type: "button", className: "acknowledge", disabled: !this.session.allow_changes, title: this.session.allow_changes ? "" : T.changesOff, ...(of ? { "aria-label": `${text}: ${of}` } : {}), onclick: () => this.acknowledge(key) }, text);
  }

  async acknowledge(alarm) {
    try {
      const { acknowledged } = await post("/api/acknowledge", { drive: this.name, alarm, who: this.who.value });
      this.note.className = "";
      say(this.note, T.acknowledged(acknowledged));
    } catch (error) {
      say(this.note, error.message);
    }
  }

  showNumbers(estimates) {
    const rows = Object.entries(this.session.quantities).map(([name, { unit, meaning }]) => {
      const row = estimates[name];
      return [name.replaceAll("_", " "), ...withSd(row?.value, row?.sd), unit === "1" ? "" : unit, row ? T.status[row.status] : "–", meaning];
    });
    if (!this.table) {
      this.table = cards(T.numbersHead, rows);
      this.numbers.replaceChildren(this.table);
      return;
    }
    const lines = this.table.querySelectorAll("tbody tr");
    rows.forEach((row, i) => row.forEach((value, k) => say(lines[i].cells[k], value)));
  }

  showNoise(noise) {
    if (!noise) {
      this.plots.noise.empty(T.noNoise);
      return;
    }
    const blank = noise.frequency_hz.map(() => null);
    const positive = (values) => (values?.length ? values : blank).map((value) => (value > 0 ? value : null));
    const { frequency_hz, fit, baseline } = noise;
    let verdict = T.noise(Math.round(noise.averages), noise.tones.length);
    if (fit && baseline.length) verdict += T.noiseChange(10 * Math.log10(power(frequency_hz, fit) / power(frequency_hz, baseline)));
    else verdict += T.noiseLearning(noise.baseline_in_s === null ? null : T.ago(noise.baseline_in_s));
    this.plots.noise.set([frequency_hz, positive(noise.psd), positive(fit), positive(baseline)], verdict);
  }

  showLoop({ loop, model, channels }, stiffness) {
    if (!loop) {
      this.plots.loop.empty(whyNoTwist(model, channels) ?? T.loopWaiting);
      return;
    }
    const none = [[], []];
    const minutes = (values) => values.map((value) => (value === null ? null : Number((value * ARC_MIN).toPrecision(6))));
    const known = loop.twist_rad.filter((value) => value !== null);
    const reach = known.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    const { spring, maker } = loop;
    const trusted = spring && stiffness?.value;
    const at = trusted ? minutes(spring.twist_rad) : [];
    const band = trusted ? [[...at, ...at.toReversed()], [...spring.high_Nm, ...spring.low_Nm.toReversed()]] : none;
    const lines = [[minutes(loop.twist_rad), loop.torque_Nm], band, trusted ? [at, spring.torque_Nm] : none, makers(maker, reach)];
    const stated = maker ? maker[1][1] / maker[1][0] : null;
    this.plots.loop.set(lines, trusted ? T.loop(...withSd(stiffness.value, stiffness.sd), stated && T.loopMaker(loop.maker_name, digits(stated), 100 * (stiffness.value / stated - 1))) : T.loopUnknown);
  }

  showLoad({ load, model }) {
    if (!load) {
      this.plots.load.empty(model.balance === "drive" ? T.noTorque : T.noLoad);
      return;
    }
    const limit = load.limits.find(([, torque]) => torque > load.peak_Nm) ?? load.limits.at(-1);
    this.plots.load.set([load.range_Nm, load.cycles], T.load(digits(load.peak_Nm), limit));
  }

  /** The stored past; the longer the span, the more seldom it is asked for, and never for a page that nobody sees. */
  async trend() {
    clearTimeout(this.timer);
    const [least, most] = TREND_EVERY_MS;
    this.timer = setTimeout(() => this.trend(), Math.min(Math.max(least, (1000 * this.span_s) / TREND_POINTS), most));
    if (document.hidden) return;
    const until_s = Date.now() / 1000 + this.ahead_s;
    const query = `drive=${encodeURIComponent(this.name)}&names=${TRENDS}&since_s=${until_s - this.span_s}&until_s=${until_s}&points=${TREND_POINTS}`;
    try {
      this.past = { ...(await getJson(`/api/trend?${query}`)), asked: [until_s - this.span_s, until_s] };
      this.showTrends(this.past);
      if (this.news) this.showQuestions(this.news);
    } catch {
      clearTimeout(this.timer); // the stream says that the gateway is away; ask again when it may be back
      this.timer = setTimeout(() => this.trend(), least);
    }
  }

  showTrends({ time_s: time, value, sd, asked }) {
    if (this.closed) return;
    const { estimates, picture } = this.news ?? { estimates: {} };
    const now = (name) => estimates[name]?.value ?? null;
    const around = (name) => [time, value[name], ...[1, -1].map((sign) => value[name].map((v, i) => (v === null ? null : v + 2 * sign * (sd[name][i] ?? 0))))];
    const parts = (name) => value[name].map((v) => (v === null ? null : 100 * v));
    const put = (id, data, names, text, instead = null) => (names.some((name) => value[name].some((v) => v !== null)) ? this.plots[id].set(data, text, asked) : this.plots[id].empty(instead ?? T.trendEmpty));
    const missing = picture ? whyNoTwist(picture.model, picture.channels) : null;
    const [ratio] = withSd(now("ratio"), estimates.ratio?.sd);
    put("error", [time, parts("model_nrmse"), parts("model_noise_floor")], ["model_nrmse"], T.error(hundred(now("model_nrmse")), hundred(now("model_noise_floor"))));
    put("stiffness", around("stiffness"), ["stiffness"], T.stiffness(now("stiffness_change")), missing);
    put("ratio", around("ratio"), ["ratio"], T.ratio(now("ratio") === null ? null : ratio, now("ratcheting_events")), missing);
    put("life", [time, value.rul_p50_h, value.rul_p90_h, value.rul_p10_h], ["rul_p50_h"], T.life(rounded(last(value.rul_p10_h)), rounded(last(value.rul_p90_h)), now("rul_p10_h") === null), T.life(null));
    put("torque", [time, value.torque_rms, value.torque_peak], ["torque_rms", "torque_peak"], T.torque(rounded(now("torque_rms")), rounded(now("torque_peak"))));
    put("level", around("noise_rms"), ["noise_rms"], T.level(...withSd(now("noise_rms"), estimates.noise_rms?.sd)), picture && !picture.noise ? T.noNoise : null);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    Object.values(this.plots).forEach((plot) => plot.close());
    this.heard?.close();
  }
}

/** Why a drive has neither twist nor stiffness nor ratio; null where it has. */
function whyNoTwist(model, channels) {
  if (model.balance === "drive") return T.oneEncoder;
  const missing = ["theta_in_rad", "theta_out_rad"].filter((name) => !channels.includes(name));
  return missing.length ? T.noEncoder(missing.join(", ")) : null;
}

const last = (values) => values?.findLast((value) => value !== null) ?? null;
const rounded = (value) => (value === null ? null : Number(value.toPrecision(3)));
const hundred = (value) => (value === null ? null : Number((100 * value).toPrecision(3)));

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

/** A stiffness in the unit that leaves two or three digits before the point. */
function stiff(value, sd) {
  const [per, unit] = value >= 1e4 ? [1000, "kN m/rad"] : [1, "N m/rad"];
  const [shown, spread] = withSd(value / per, sd / per);
  return [shown.length > 6 ? (value / per).toPrecision(5) : shown, spread, unit];
}

/** Hours as a person says them, digits in groups of three. */
const hours = (h) => `${Number(h.toPrecision(2)).toLocaleString("en").replaceAll(",", " ")} h`;
const named = (effect) => effect.replaceAll("_", " ").replaceAll("+", " + ");

/** Names with their probability, "none of them" always among them. */
function ranked(candidates) {
  const shown = (p) => (p < 0.005 ? "< 1 %" : `${Math.round(100 * p)} %`);
  const best = candidates.slice(0, 2).map((row) => [`${named(row.effect)} ${shown(row.probability)}`, row.probability]);
  const none = Math.max(0, 1 - candidates.reduce((sum, row) => sum + row.probability, 0));
  return [...best, [`${Q.none} ${shown(none)}`, none]];
}

/** What an event puts on the trends: time, words, and whether it is a trouble; null of what is none of them. */
function marked({ time_s, source, message, rank }) {
  if (source === "model") return [time_s, T.marks.model, 0];
  if (source === "daemon" && message.startsWith("measuring")) return [time_s, T.marks.start, 0];
  return rank > 0 ? [time_s, adviceOf(message)[0].slice(0, 40), rank] : null;
}
