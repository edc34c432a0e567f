// The sound that was kept, over months: a picture of levels, what changed in it, and the same as a table.
import { T, clock, digits, el, getJson, save, say, table } from "./dom.js";

const S = T.soundView;
const HEIGHT_PX = 300;
const LEFT_PX = 64;
const BELOW_PX = 40;
const TABLE_ROWS = 24;
const TABLE_BANDS = 8;
// A line of one order is a band or two wide: so many to either side tell what is usual around it.
const NEAR_BANDS = 6;
// The scatter of an hour's average is below 1 dB: colours never spread over less than this.
const LEAST_DB = 4;
// Dark to light in steps that print well and are told apart by those who do not see colours (after viridis).
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const shade = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export class SoundView {
  constructor(drive) {
    this.drive = drive;
    this.regime = "";
    this.verdict = el("p", { className: "verdict", role: "status" }, T.waiting);
    this.canvas = el("canvas", { role: "img", "aria-label": S.title });
    this.place = el("div", { className: "chart" }, this.canvas);
    this.scale = el("p", { className: "quiet" });
    this.choice = el("select", { id: "regime", onchange: () => this.ask(this.choice.value) });
    this.table = el("details", {}, el("summary", {}, T.asTable));
    this.table.addEventListener("toggle", () => this.fillTable());
    const csv = el("button", { type: "button", title: T.csvOf(S.title), onclick: () => this.saveCsv() }, T.csv);
    this.node = el("section", { className: "plot", id: "plot-sound" }, el("h3", {}, S.title), this.verdict, el("label", {}, S.regime, this.choice), this.place, this.scale, el("div", { className: "tools" }, this.table, csv));
    this.watch = new ResizeObserver(() => this.draw());
    this.watch.observe(this.place);
    this.ask();
  }

  async ask(regime = "") {
    try {
      this.found = await getJson(`/api/sound?drive=${encodeURIComponent(this.drive)}${regime === "" ? "" : `&regime=${regime}`}`);
    } catch (error) {
      say(this.verdict, error.message);
      return;
    }
    const { time_s, change, regimes } = this.found;
    this.node.classList.toggle("empty", !time_s.length);
    say(this.verdict, time_s.length ? S.verdict(time_s.length, change) : S.none);
    this.canvas.setAttribute("aria-label", `${S.title}: ${this.verdict.textContent}`);
    this.choice.replaceChildren(...regimes.map(([number, speed, hours]) => el("option", { value: number, selected: number === this.found.regime }, S.speed(number, digits(speed), hours))));
    this.choice.parentNode.hidden = regimes.length < 2;
    this.draw();
    this.fillTable();
  }

  draw() {
    const wide = this.place.clientWidth;
    if (!wide || !this.found?.time_s.length) return;
    const scale = devicePixelRatio;
    this.canvas.width = wide * scale;
    this.canvas.height = HEIGHT_PX * scale;
    this.canvas.style.width = `${wide}px`;
    this.canvas.style.height = `${HEIGHT_PX}px`;
    const pen = this.canvas.getContext("2d");
    pen.scale(scale, scale);
    const { time_s, frequency_hz, level_dB } = this.found;
    const { above_dB, low, high } = standing(level_dB);
    const step = Math.min(...time_s.slice(1).map((t, i) => t - time_s[i]), time_s.at(-1) - time_s[0] || 3600);
    const begin = time_s[0] - step / 2;
    const x = (t) => LEFT_PX + ((t - begin) / (time_s.at(-1) + step / 2 - begin)) * (wide - LEFT_PX - 12);
    const tall = (HEIGHT_PX - BELOW_PX - 8) / frequency_hz.length;
    const y = (band) => HEIGHT_PX - BELOW_PX - (band + 1) * tall;
    above_dB.forEach((row, i) => row.forEach((value, band) => {
      if (value === null) return;
      pen.fillStyle = colour((value - low) / (high - low));
      pen.fillRect(x(time_s[i] - step / 2), y(band), x(time_s[i] + step / 2) - x(time_s[i] - step / 2) + 0.5, tall + 0.5);
    }));
    this.axes(pen, wide, x, (band) => y(band) + tall / 2);
    say(this.scale, S.scale(digits(low), digits(high)));
  }

  axes(pen, wide, x, y) {
    const { time_s, frequency_hz } = this.found;
    pen.fillStyle = shade("--ink");
    pen.font = "13px system-ui";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const every = Math.ceil(frequency_hz.length / 7);
    frequency_hz.forEach((hz, band) => band % every === 0 && pen.fillText(digits(hz, 2), LEFT_PX - 6, y(band)));
    pen.textAlign = "center";
    const ticks = Math.max(2, Math.min(6, Math.floor((wide - LEFT_PX) / 110)));
    for (let i = 0; i < ticks; i++) {
      const t = time_s[0] + ((i + 0.5) / ticks) * (time_s.at(-1) - time_s[0]);
      pen.fillText(clock(t).slice(0, time_s.at(-1) - time_s[0] > 172800 ? 10 : 16), x(t), HEIGHT_PX - BELOW_PX + 14);
    }
    pen.fillText(T.axis.time, LEFT_PX + (wide - LEFT_PX) / 2, HEIGHT_PX - 10);
    pen.save();
    pen.translate(10, (HEIGHT_PX - BELOW_PX) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(T.axis.frequency, 0, 0);
    pen.restore();
  }

  fillTable() {
    if (!this.table.open || !this.found) return;
    const { time_s, frequency_hz, level_dB } = this.found;
    const bands = some(frequency_hz, TABLE_BANDS);
    const rows = some(time_s, TABLE_ROWS).map((i) => [clock(time_s[i]), ...bands.map((band) => level_dB[i][band] ?? "–")]);
    const shown = table([T.axis.time, ...bands.map((band) => `${digits(frequency_hz[band])} Hz`)], rows);
    this.table.replaceChildren(this.table.firstChild, shown);
  }

  saveCsv() {
    if (!this.found) return;
    const { time_s, frequency_hz, level_dB } = this.found;
    const rows = time_s.map((t, i) => [clock(t), ...level_dB[i].map((value) => value ?? "")].join(","));
    save(`${this.drive}-sound.csv`, `${["time", ...frequency_hz.map((hz) => `${hz} Hz, dB re 1/Hz`)].map((name) => `"${name}"`).join(",")}\r\n${rows.join("\r\n")}\r\n`);
  }

  close() {
    this.watch.disconnect();
  }
}

/** Numbers of about so many of a list, from the first to the last. */
const some = (list, most) => list.map((_, i) => i).filter((i) => i % Math.ceil(list.length / most) === 0);

/** What stands out of the usual around it, in dB, and between which of these levels colours run.
 *
 * Noise falls by tens of dB towards high frequencies, beside which one line of a bearing would be no brighter than the
 * rest: each level is told above the middle of its neighbours over all of the time. A fiftieth of all lies beyond each end,
 * so that one loud hour does not pale the rest. */
export function standing(level_dB) {
  const own = level_dB[0].map((_, band) => middle(level_dB.map((row) => row[band])));
  const usual = own.map((_, band) => {
    const near = Math.min(NEAR_BANDS, band, own.length - 1 - band);
    return middle(own.slice(band - near, band + near + 1)) ?? 0;
  });
  const above_dB = level_dB.map((row) => row.map((value, band) => value === null ? null : value - usual[band]));
  const sorted = above_dB.flat().filter((value) => value !== null).sort((a, b) => a - b);
  const low = sorted[Math.floor(0.02 * (sorted.length - 1))];
  return { above_dB, low, high: Math.max(sorted[Math.ceil(0.98 * (sorted.length - 1))], low + LEAST_DB) };
}

/** The median of what is known in a list; null where nothing is. */
function middle(values) {
  const known = values.filter((value) => value !== null).sort((a, b) => a - b);
  return known.length ? known[known.length >> 1] : null;
}

function colour(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const i = Math.min(Math.floor(at), RAMP.length - 2);
  return `rgb(${RAMP[i].map((from, k) => Math.round(from + (at - i) * (RAMP[i + 1][k] - from))).join()})`;
}
