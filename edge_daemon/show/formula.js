// A formula as it is written: what the gateway's parser says of it at once, and the names it may be made of.
import { T, el, getJson, say } from "./dom.js";

const F = T.formula;
const PAUSE_MS = 150;
const MOST_OFFERED = 8;

export class FormulaBox {
  /** `input` gets a list of names below it, and a line that says what is wrong and where. */
  constructor(input) {
    this.input = input;
    this.offered = [];
    this.chosen = -1;
    this.channels = [];
    this.functions = [];
    this.list = el("ul", { id: "names", role: "listbox", className: "offers", hidden: true, "aria-label": F.names });
    this.word = el("p", { id: "formula-word", className: "quiet", role: "status" });
    for (const [name, value] of Object.entries({ role: "combobox", "aria-autocomplete": "list", "aria-controls": "names", "aria-expanded": "false", "aria-describedby": "formula-word" })) input.setAttribute(name, value);
    input.addEventListener("input", () => this.written());
    input.addEventListener("keydown", (event) => this.key(event));
    input.addEventListener("blur", () => this.offer([]));
    this.check("0");
  }

  written() {
    const begun = /[A-Za-z_]\w*$/.exec(this.input.value.slice(0, this.input.selectionStart))?.[0] ?? "";
    const like = (name) => name !== begun && (name.startsWith(begun) || name.split("_").includes(begun));
    this.offer(begun.length > 1 ? [...this.channels, ...this.functions].filter(like).slice(0, MOST_OFFERED) : []);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(this.input.value), PAUSE_MS);
  }

  async check(text) {
    try {
      const found = await getJson(`/api/formula?text=${encodeURIComponent(text)}`);
      this.functions = found.names?.functions ?? [];
      this.channels = [...new Set([...this.channels, ...(found.names?.channels ?? [])])];
      if (text === this.input.value) this.tell(found, text);
    } catch {
      this.tell({ error: "" }, "");
    }
  }

  tell({ error, at, amplitudes = [], shapes = [], meant = {} }, text) {
    const doubt = Object.entries(meant)[0];
    this.word.className = error ? "bad" : doubt ? "warn" : "quiet";
    this.input.toggleAttribute("aria-invalid", Boolean(error));
    say(this.word, !text ? "" : error ? F.wrong(error, at + 1) : doubt ? F.meant(...doubt) : F.fits(amplitudes.join(", "), shapes.join(", ")));
  }

  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!this.offered.length) return;
    if (step) this.choose((this.chosen + step + this.offered.length) % this.offered.length);
    else if (event.key === "Escape") this.offer([]);
    else if (event.key === "Tab" || (event.key === "Enter" && this.chosen >= 0)) this.put(this.offered[Math.max(this.chosen, 0)]);
    else return;
    event.preventDefault();
  }

  offer(names) {
    this.offered = names;
    this.chosen = -1;
    this.list.hidden = !names.length;
    this.input.setAttribute("aria-expanded", String(names.length > 0));
    this.input.removeAttribute("aria-activedescendant");
    this.list.replaceChildren(...names.map((name, i) => el("li", { id: `name-${i}`, role: "option", "aria-selected": "false", onmousedown: (event) => { event.preventDefault(); this.put(name); } }, name)));
  }

  choose(at) {
    this.chosen = at;
    [...this.list.children].forEach((row, i) => row.setAttribute("aria-selected", String(i === at)));
    this.input.setAttribute("aria-activedescendant", `name-${at}`);
  }

  /** The name in place of what was begun of it; a function with its bracket. */
  put(name) {
    const end = this.input.selectionStart;
    const begin = end - (/\w*$/.exec(this.input.value.slice(0, end))?.[0].length ?? 0);
    this.input.setRangeText(this.functions.includes(name) ? `${name}(` : name, begin, end, "end");
    this.input.focus();
    this.written();
    this.offer([]);
  }
}
