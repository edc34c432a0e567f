// Plots: a title, a one-line verdict, a chart by uPlot, its data as a table and as CSV. Without uPlot the table stays.
import { T, clock, el, save, say, table } from "./dom.js";

const HEIGHT_PX = 260;
const TABLE_ROWS = 40;
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3], []];
const shade = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const dark = matchMedia("(prefers-color-scheme: dark)");

/**
 * `lines`: names of the lines, in order of the data. `xy`: each line has its own x (a loop); data are then pairs [x, y].
 * `band`: [upper, lower] numbers of lines with the room between them filled. `time`: x is seconds since the epoch.
 * `area`: number of a line with its own x that goes around an area, `curve`: of the one that stands out. `onSelect(from, to)`: a stretch of x was dragged over.
 */
export class Plot {
  constructor(title, { x, y, lines, xy = false, logX = false, logY = false, band = null, time = false, whole = false, bars = false, area = null, curve = null, onSelect = null, id = "" }) {
    Object.assign(this, { title, x, y, lines, xy, logX, logY, band, time, bars, whole, area, curve, onSelect, data: null, chart: null, marks: [], held: null });
    this.verdict = el("p", { className: "verdict" });
    this.place = el("div", { className: "chart", role: "img", "aria-label": title });
    this.table = el("details", { open: !window.uPlot }, el("summary", {}, T.asTable));
    this.table.addEventListener("toggle", () => this.fillTable());
    const csv = el("button", { type: "button", title: T.csvOf(title), onclick: () => this.saveCsv() }, T.csv);
    this.node = el("section", { className: "plot", id: id ? `plot-${id}` : "" }, el("h3", {}, title), this.verdict, this.place, el("div", { className: "tools" }, this.table, csv));
    this.watch = new ResizeObserver(() => this.fit());
    this.watch.observe(this.place);
    this.repaint = () => this.draw(true);
    dark.addEventListener("change", this.repaint);
  }

  /** A folded plot is drawn when it is unfolded, and one on a screen that is turned, anew. */
  fit() {
    if (!this.place.clientWidth) return;
    if (this.chart) this.chart.setSize({ width: this.place.clientWidth, height: HEIGHT_PX });
    else this.draw();
  }

  /** What happened, on an axis of time: `[time, words, rank]`, rank 0 of what is no trouble. */
  mark(marks) {
    this.marks = marks;
    this.chart?.redraw(false);
  }

  /** Nothing to draw, and why. */
  empty(verdict) {
    this.chart?.destroy();
    this.chart = this.data = null;
    this.node.classList.add("empty");
    this.place.setAttribute("aria-label", `${this.title}: ${verdict}`);
    say(this.verdict, verdict);
  }

  set(data, verdict, asked = null) {
    this.data = data;
    this.asked = asked;
    this.node.classList.remove("empty");
    say(this.verdict, verdict);
    this.place.setAttribute("aria-label", `${this.title}: ${verdict}`);
    this.draw();
    if (this.table.open) this.fillTable();
  }

  draw(anew = false) {
    if (!window.uPlot || !this.data || !this.place.clientWidth) return;
    if (anew) {
      this.chart?.destroy();
      this.chart = null;
      this.zoomed = false;
    }
    const data = this.xy ? [null, ...this.data] : this.data;
    if (this.chart && this.zoomed) {
      this.chart.setData(data, false);
      this.chart.redraw();
    } else if (this.chart) this.chart.setData(data);
    else this.chart = new window.uPlot(this.options(), data, this.place);
    this.node.dataset.drawn = "yes";
  }

  options() {
    const ink = shade("--ink");
    const axis = (label) => ({ label, stroke: ink, grid: { stroke: shade("--grid"), filter: decades }, ticks: { stroke: shade("--grid"), filter: decades }, labelSize: 22, font: "13px system-ui", labelFont: "13px system-ui" });
    const scale = (log) => ({ distr: log ? 3 : 1 });
    const series = this.lines.map((label, i) => this.series(label, i));
    return {
      width: this.place.clientWidth || 480,
      height: HEIGHT_PX,
      padding: [null, 24, null, null],
      mode: this.xy ? 2 : 1,
      scales: { x: { ...scale(this.logX), time: this.time, ...this.reach() }, y: { ...scale(this.logY), ...(this.xy ? { range: () => span(this.data, 1) } : this.time ? { range: (u, low, high) => this.steady(low, high) } : {}) } },
      axes: [
        { ...axis(this.x), values: this.time ? CLOCK : ticks, ...(this.time ? { space: 64 } : {}), ...(this.whole ? { incrs: [1, 2, 5, 10] } : {}) },
        { ...axis(this.y), size: room, values: ticks },
      ],
      series: [this.xy ? {} : { label: this.x, value: this.time ? "{YYYY}-{MM}-{DD} {HH}:{mm}:{ss}" : shown }, ...series],
      bands: this.band ? [{ series: this.band.map((n) => n + 1), fill: `${shade("--c1")}33` }] : [],
      tzDate: (time_s) => window.uPlot.tzDate(new Date(1000 * time_s), "Etc/UTC"),
      legend: { live: !this.xy },
      cursor: { drag: { x: !this.xy, y: false, setScale: !this.onSelect } },
      hooks: { draw: [(u) => this.time && drawMarks(u, this.marks)], setSelect: [(u) => this.dragged(u)], ready: [(u) => u.over.addEventListener("dblclick", () => (this.zoomed = false))] },
    };
  }

  /** From where to where x goes: whole bars, the span that was asked for, or all points of a loop. */
  reach() {
    if (this.xy) return { range: () => span(this.data, 0) };
    if (this.bars) return { range: (u, low, high) => [0, high + (this.data[0][1] - this.data[0][0]) / 2 || 1] };
    if (this.time) return { range: (u, low, high) => (this.zoomed ? [low, high] : this.within()) };
    return {};
  }

  /** An axis that does not jump: it grows with its line, and shrinks when that has left half of it empty. */
  steady(low, high) {
    if (low === null || high === null) return this.held ?? [0, 1];
    const margin = 0.1 * (high - low || Math.abs(high) || 1);
    const [from, to] = this.held ?? [Infinity, -Infinity];
    if (low < from || high > to || high - low + 2 * margin < 0.5 * (to - from)) this.held = [low >= 0 ? Math.max(0, low - margin) : low - margin, high + margin];
    return this.held;
  }

  /** A stretch of x was dragged over: taken as an answer, or looked at closer until a double click. */
  dragged(u) {
    if (!(u.select.width > 0)) return;
    if (this.onSelect) this.onSelect(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
    else this.zoomed = true;
  }

  /** At least a twentieth of the asked span, so that the first points do not fill it. */
  within() {
    const [low, high] = [this.data[0][0] ?? 0, this.data[0].at(-1) ?? 1];
    const [from, to] = this.asked ?? [low, high];
    const end = Math.max(high, to);
    return [Math.min(low, end - (to - from) / 20 - 1), end];
  }

  series(label, i) {
    const colour = shade(i === this.curve ? "--c2" : `--c${(i % 5) + 1}`);
    if (i === this.area) return { label, stroke: null, fill: `${shade("--c2")}44`, facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }], paths: around };
    const look = { label, value: shown, stroke: colour, width: i === this.curve ? 3 : i === 0 && this.curve === null ? 2 : 1.6, dash: i === this.curve ? [] : DASHES[i % DASHES.length], points: { show: false }, spanGaps: false };
    if (this.band?.includes(i)) return { ...look, width: 0, class: "banded" };
    if (this.xy) return { ...look, facets: [{ scale: "x", auto: true }, { scale: "y", auto: true }], paths: course };
    if (this.bars) return { ...look, fill: `${colour}66`, paths: window.uPlot.paths.bars({ size: [0.9, 100] }) };
    return { ...look, points: { show: (u) => u.data[0].length < 12, size: 7 } };
  }

  rows() {
    if (!this.xy) return this.data[0].map((x, i) => [x, ...this.data.slice(1).map((line) => line[i])]);
    return this.data.flatMap(([xs, ys], n) => xs.map((x, i) => [this.lines[n], x, ys[i]]));
  }

  head() {
    return this.xy ? ["", this.x, this.y] : [this.x, ...this.lines.map((line) => `${line}, ${this.y}`)];
  }

  fillTable() {
    if (!this.table.open || !this.data) return;
    const rows = this.rows();
    const every = Math.max(1, Math.ceil(rows.length / TABLE_ROWS));
    const shown = rows.filter((_, i) => i % every === 0).map((row) => row.map((value, i) => (this.time && i === 0 ? clock(value) : value ?? "–")));
    this.table.lastChild.replaceWith(this.table.children.length > 1 ? table(this.head(), shown) : this.table.lastChild);
    if (this.table.children.length < 2) this.table.append(table(this.head(), shown));
  }

  saveCsv() {
    if (!this.data) return;
    const quoted = (value) => (typeof value === "string" ? `"${value.replaceAll('"', '""')}"` : value ?? "");
    const of = decodeURIComponent(location.hash.split("/")[2] ?? "");
    const name = `${of} ${this.title}`.trim().toLowerCase().replaceAll(" ", "-");
    const rows = this.rows().map((row) => (this.time ? [clock(row[0]), ...row.slice(1)] : row));
    save(`${name}.csv`, [this.head(), ...rows].map((row) => row.map(quoted).join(",")).join("\r\n") + "\r\n");
  }

  close() {
    this.watch.disconnect();
    dark.removeEventListener("change", this.repaint);
    this.chart?.destroy();
    this.chart = null;
  }
}

// A day's 24 hours and dates that sort, whatever the browser's country: [step, text, and what is added where that changes]
const CLOCK = [
  [31536000, "{YYYY}", null, null, null, null, null, null, 1],
  [2419200, "{MMM}", "\n{YYYY}", null, null, null, null, null, 1],
  [86400, "{MM}-{DD}", "\n{YYYY}", null, null, null, null, null, 1],
  [60, "{HH}:{mm}", "\n{YYYY}-{MM}-{DD}", null, "\n{MM}-{DD}", null, null, null, 1],
  [1, "{HH}:{mm}:{ss}", "\n{YYYY}-{MM}-{DD}", null, "\n{MM}-{DD}", null, null, null, 1],
];

const shown = (u, value) => (value === null || value === undefined ? "" : Number(value.toPrecision(6)).toString());

/** On a logarithmic axis only whole powers of ten get a line: the steps between them would be a grey wall. */
const decades = (u, values, axis) => (u.scales[u.axes[axis].scale].distr === 3 ? values.map((value) => (Math.abs(Math.log10(value) % 1) < 1e-6 ? value : null)) : values);

/** Numbers at an axis: as short as they stay different; none where the axis leaves a tick without. */
function ticks(u, values, axis) {
  const present = values.filter((value) => value !== null);
  const most = Math.max(...present.map(Math.abs));
  const step = present.length > 1 ? Math.min(...present.slice(1).map((value, i) => Math.abs(value - present[i]))) : most;
  const long = most >= 1e6 || most < 1e-3 || step < 1e-6;
  const places = [0, 1, 2, 3, 4, 5].find((n) => Math.abs(Math.round(step * 10 ** n) / 10 ** n - step) < 1e-6 * step) ?? 6;
  const text = (value) => (value === 0 ? "0" : long ? Number(value.toPrecision(6)).toExponential().replace("e+", "e") : value.toFixed(places));
  const exact = (value) => (value < 0.01 || value > 1e5 ? value.toExponential(0).replace("e+", "e") : String(value));
  return values.map((value) => (value === null || value === undefined ? "" : u.scales[u.axes[axis].scale].distr === 3 ? exact(value) : text(value)));
}

/** From the lowest to the highest value of all lines, with a margin. */
function span(lines, which) {
  let low = Infinity;
  let high = -Infinity;
  for (const line of lines) {
    for (const value of line[which]) {
      if (value === null) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  if (!(low <= high)) return [-1, 1];
  const margin = 0.05 * (high - low || Math.abs(high) || 1);
  return [low - margin, high + margin];
}

/** As wide as the longest number at the axis wants, its label beside it. */
const room = (u, values) => Math.max(64, 34 + 7.5 * Math.max(0, ...(values ?? []).map((text) => text.length)));

/** The area that the points of a line go around. */
function around(u, n) {
  const [xs, ys] = u.data[n];
  const fill = new Path2D();
  xs.forEach((x, i) => fill[i ? "lineTo" : "moveTo"](u.valToPos(x, "x", true), u.valToPos(ys[i], "y", true)));
  fill.closePath();
  return { stroke: null, fill, clip: null, flags: 2 };
}

/** A line through its points in their own order, broken where one is missing. */
function course(u, n) {
  const [xs, ys] = u.data[n];
  const stroke = new Path2D();
  let drawing = false;
  for (let i = 0; i < xs.length; i++) {
    if (xs[i] === null || ys[i] === null) drawing = false;
    else {
      const at = [u.valToPos(xs[i], "x", true), u.valToPos(ys[i], "y", true)];
      if (drawing) stroke.lineTo(...at);
      else stroke.moveTo(...at);
      drawing = true;
    }
  }
  return { stroke, fill: null, clip: null, flags: 1 };
}

/** Dashed lines where something happened, its words beside the line where they do not run into the next. */
function drawMarks(u, marks) {
  const { ctx, bbox } = u;
  const scale = devicePixelRatio;
  const inside = marks.map(([t, words, rank]) => [u.valToPos(t, "x", true), words, rank]).filter(([x]) => x >= bbox.left && x <= bbox.left + bbox.width);
  ctx.save();
  ctx.font = `${11 * scale}px system-ui`;
  ctx.textAlign = "left";
  inside.forEach(([x, words, rank], i) => {
    ctx.strokeStyle = ctx.fillStyle = shade(rank ? "--warn" : "--quiet");
    ctx.setLineDash([3 * scale, 4 * scale]);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    const end = inside[i + 1]?.[0] ?? bbox.left + bbox.width;
    if (ctx.measureText(words).width + 8 * scale < end - x) ctx.fillText(words, x + 4 * scale, bbox.top + 12 * scale);
  });
  ctx.restore();
}
