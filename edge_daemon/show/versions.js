// The model's versions side by side: what it grew by, what has a name, and what was tried and not kept; two compared.
import { T, cards, el, percent, withSd } from "./dom.js";

const V = T.versions;

/**
 * `rows`: versions as the gateway tells them, oldest first, the one in force last; `lineage`: changes with their
 * held-out errors; `trials`: what was tried; `act(what, about)` with what = "undo", "try", "keep", "forget", "name",
 * "restore", "unname" or "between"; `may`: whether the model may be changed.
 */
export function versions({ rows, lineage, effects, nrmse = null, trials, may, compared, act }) {
  const button = (text, what, about, allowed, label, className = "try") => el("button", { type: "button", className, disabled: !allowed, "aria-label": label, onclick: () => act(what, about) }, text);
  const title = (row) => row.name || (row.key === "now" ? V.now : V.before(row.change));
  const pick = (row) => el("input", { type: "checkbox", className: "pick", value: row.key, "aria-label": V.pick(title(row)), onchange: ready });
  const doing = (row) => {
    if (row.key === "now") return rows.some((one) => one.change) ? button(V.undo, "undo", null, may, V.undo) : "";
    const back = button(V.restore, "restore", row, may, V.restoreOf(title(row)));
    return row.name ? el("span", {}, back, " ", button(V.forget, "unname", row, may, V.forgetOf(title(row)))) : back;
  };
  const error = (row) => percent(row.key === "now" && nrmse !== null ? nrmse : row.nrmse);
  const line = (row) => [title(row), row.effects.join(", "), error(row), pick(row), doing(row)];
  const tried = trials.map((row) => [
    row.without ? V.left(row.effect) : V.with(row.effect, row.expression), "", percent(row.nrmse), "",
    el("span", {}, button(row.without ? V.remove : V.add, "keep", row, may, V.keepOf(row.effect), "add"), " ", button(V.drop, "forget", row, true, V.dropOf(row.effect))),
  ]);
  const without = effects.length > 1 ? effects.map((effect) => button(V.without(effect), "try", { effect, expression: null, without: true }, true, V.tryWithout(effect))) : [];
  const between = el("button", { type: "button", id: "between", disabled: true, onclick: () => act("between", picked()) }, V.between);
  const picked = () => [...node.querySelectorAll(".pick:checked")].map((box) => box.value);
  function ready() {
    between.disabled = !(compared && picked().length === 2);
  }
  const name = el("input", { id: "version-name", maxLength: 40, required: true, autocomplete: "off" });
  const naming = el("form", { className: "row", onsubmit: (event) => { event.preventDefault(); act("name", { name: name.value }); } }, el("label", {}, V.nameIt, name), el("button", { id: "name-version", disabled: !may }, V.name), between, el("span", { className: "quiet" }, compared ? V.pickTwo : V.compareFirst));
  const node = el("section", { id: "versions", className: "card" }, el("h2", {}, V.heading), cards(V.head, [...[...rows].reverse().map(line), ...tried]), naming, without.length ? el("p", { className: "row" }, el("span", { className: "quiet" }, V.tryIt), ...without) : "");
  return node;
}

/** Two versions on the same data: the error of each, then every number that one of them has. */
export function sideBySide({ versions: two, parameters }, title) {
  const value = (row) => (row ? `${withSd(row.value, row.sd).filter(Boolean).join(" ± ")} ${row.unit}${row.identified ? "" : ` ${V.unsure}`}` : "–");
  const head = [V.what, ...two.map((row) => title(row.key))];
  const first = [V.error, ...two.map((row) => `${percent(row.nrmse)} %`)];
  const floor = [V.floor, ...two.map((row) => `${percent(row.noise_floor_nrmse)} %`)];
  const rows = parameters.map((row) => [`${row.effect}: ${row.name}`, ...row.of.map(value)]);
  return el("section", { className: "card", id: "side-by-side" }, el("h2", {}, V.sideBySide), cards(head, [first, floor, ...rows]));
}
