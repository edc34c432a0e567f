// What the columns of an uploaded recording are: their first values, a guess, and a person's answer.
import { T, el, table } from "./dom.js";

const C = T.columns;

/** A form over `/api/columns`; `use(rows)` takes what was chosen. */
export function columnForm({ columns, units }, use) {
  const rows = columns.map((column) => choices(column, units));
  const send = (event) => {
    event.preventDefault();
    use(rows.map((row) => row.answer()));
  };
  return el("form", { onsubmit: send }, el("h3", {}, C.heading), el("p", { className: "quiet" }, C.advice), table(C.head, rows.map((row) => row.cells)), el("p", {}, el("button", { className: "main", id: "use-columns" }, C.use)));
}

function choices({ name, values, channel, unit, reverse: other }, units) {
  const what = el("select", { "aria-label": C.what(name), onchange: () => fill(units[what.value]?.[0]) }, el("option", { value: "" }, C.unwanted), ...Object.keys(units).map((one) => el("option", { value: one, selected: one === channel }, one)));
  const in_ = el("select", { "aria-label": C.unit(name) });
  const reverse = el("input", { type: "checkbox", checked: Boolean(other), "aria-label": C.reverse(name) });
  const fill = (chosen) => in_.replaceChildren(...(units[what.value] ?? []).map((one) => el("option", { value: one, selected: one === chosen }, one)));
  fill(unit);
  return { cells: [name, values.slice(0, 3).join(", "), what, in_, reverse], answer: () => ({ name, channel: what.value, unit: in_.value, reverse: reverse.checked }) };
}
