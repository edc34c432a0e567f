// The model's versions side by side: what it grew by, what it has, and what was tried and not kept.
import { T, cards, el, percent } from "./dom.js";

const V = T.versions;

/**
 * `lineage`: changes with their held-out errors, oldest first; `effects`: names in the model now; `trials`: what was
 * tried; `act(what, trial)` with what = "undo", "try", "keep" or "forget"; `may`: whether the model may be changed, and undone.
 */
export function versions({ lineage, effects, nrmse = null, trials, may, act }) {
  const button = (text, what, trial, allowed, label) => el("button", { type: "button", className: what === "keep" ? "add" : "try", disabled: !allowed, "aria-label": label, onclick: () => act(what, trial) }, text);
  const kept = lineage.map((row, i) => {
    const newest = i === lineage.length - 1;
    return [`${row.change}${newest ? ` · ${V.now}` : ""}`, percent(row.nrmse), newest && i > 0 ? button(V.undo, "undo", null, may.undo, V.undo) : ""];
  });
  if (!kept.length) kept.push([V.begun, nrmse === null ? "–" : percent(nrmse), ""]);
  const tried = trials.map((row) => [
    row.without ? V.left(row.effect) : V.with(row.effect, row.expression), percent(row.nrmse),
    el("span", {}, button(row.without ? V.remove : V.add, "keep", row, may.change, V.keepOf(row.effect)), " ", button(V.forget, "forget", row, true, V.forgetOf(row.effect))),
  ]);
  const without = effects.length > 1 ? effects.map((effect) => button(V.without(effect), "try", { effect, expression: null, without: true }, true, V.tryWithout(effect))) : [];
  return el("section", { id: "versions", className: "card" }, el("h2", {}, V.heading), cards(V.head, [...kept, ...tried]), without.length ? el("p", { className: "row" }, el("span", { className: "quiet" }, V.tryIt), ...without) : "");
}
