// All drives, the worst first.
import { T, cards, digits, el, mood, percent, say } from "./dom.js";

export const FAIR = 3; // up to so many times sensor noise nothing need be missing, as the daemon's own words say

/** What is wrong and what to do: the daemon's sentences have the advice after their last colon. */
export function adviceOf(reason) {
  const at = reason.lastIndexOf(": ");
  return at < 0 ? [reason, ""] : [reason.slice(0, at), reason.slice(at + 2)];
}

export class Overview {
  constructor() {
    this.verdict = el("p", { className: "verdict", id: "verdict", role: "status" }, T.waiting);
    this.table = cards(T.overviewHead, []);
    this.body = this.table.querySelector("tbody");
    this.node = el("div", { id: "overview" }, this.verdict, this.table);
    this.lines = new Map();
  }

  /** Worst first as the gateway sorts them. Only what differs is touched: a link keeps its focus. */
  state({ drives }) {
    say(this.verdict, T.overview(drives.length, drives.filter((row) => row.rank > 0 || lacking(row)), drives.some((row) => row.state === "starting")));
    this.table.hidden = !drives.length;
    const known = new Set(drives.map((row) => row.name));
    for (const [name, line] of this.lines) {
      if (known.has(name)) continue;
      line.remove();
      this.lines.delete(name);
    }
    drives.forEach((row, i) => {
      const line = this.lines.get(row.name) ?? this.begin(row.name);
      this.fill(line, row);
      if (this.body.rows[i] !== line) this.body.insertBefore(line, this.body.rows[i] ?? null);
    });
  }

  begin(name) {
    const link = el("a", { href: `#/drive/${encodeURIComponent(name)}` }, name);
    const line = cards(T.overviewHead, [[link, "", "", "", "", "", "", ""]]).querySelector("tbody tr");
    this.lines.set(name, line);
    return line;
  }

  fill(line, row) {
    const why = lacking(row) ? T.modelMisses(percent(row.model_nrmse, 2)) : null;
    const texts = [T.state[row.state] ?? row.state, row.reasons[0] ?? why ?? (row.rank === 5 ? T.checkSource : row.state === "starting" ? T.starting : T.nothing), percentOf(row.health_index), digits(row.rul_p10_h), digits(row.stiffness, 4), percent(row.model_nrmse)];
    texts.forEach((text, k) => say(line.cells[k + 1], text));
    this.offer(line, row.name, lacking(row));
    const look = why && row.rank === 0 ? "warn" : mood(row.rank);
    if (line.cells[1].className !== look) line.cells[1].className = look;
  }

  /** The way to what a model lacks, beside its error. */
  offer(line, name, lacks) {
    const cell = line.cells[7];
    if (Boolean(cell.firstChild) === lacks) return;
    cell.replaceChildren(...(lacks ? [el("a", { className: "button", href: `#/compare/${encodeURIComponent(name)}/find` }, T.find)] : []));
  }

  close() {}
}

/** Whether a model misses so many times more than sensor noise that something can be named. */
const lacking = (row) => Boolean(row.model_nrmse && row.model_noise_floor && row.model_nrmse > FAIR * row.model_noise_floor);

const percentOf = (value) => (value === null ? "–" : `${Math.round(100 * value)} %`);
