// Small pictures beside a large number: its past with a band, a range, a share of a limit, bars by rank.
const WIDTH = 260;
const HEIGHT = 54;

function svg(tag, attributes, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

const picture = (...parts) => svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true", class: "gauge" }, ...parts);
const path = (points, close = "") => `${points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("")}${close}`;

/** A value over time, two standard deviations to either side; empty before there are two points. */
export function spark(time, value, sd) {
  const rows = time.map((t, i) => [t, value[i], 2 * (sd[i] ?? 0)]).filter(([, v]) => v !== null);
  if (rows.length < 2) return picture();
  const low = Math.min(...rows.map(([, v, s]) => v - s));
  const high = Math.max(...rows.map(([, v, s]) => v + s));
  const room = Math.max(high - low, 0.002 * Math.abs(high)) || 1; // a steady value stays a quiet line
  const middle = (high + low) / 2;
  const x = (t) => ((t - rows[0][0]) / (rows.at(-1)[0] - rows[0][0])) * WIDTH;
  const y = (v) => HEIGHT / 2 - ((v - middle) / room) * (HEIGHT - 8);
  const upper = rows.map(([t, v, s]) => [x(t), y(v + s)]);
  const lower = rows.map(([t, v, s]) => [x(t), y(v - s)]).reverse();
  return picture(svg("path", { d: path([...upper, ...lower], "Z"), class: "band" }), svg("path", { d: path(rows.map(([t, v]) => [x(t), y(v)])), class: "curve" }));
}

/** P10 to P90 as a bar, the middle one as a mark, from now to a round number beyond. */
export function range(p10, p50, p90, words) {
  const most = 1.1 * p90;
  const x = (h) => (h / most) * WIDTH;
  return picture(
    svg("path", { d: `M0 38H${WIDTH}`, class: "axis" }),
    svg("rect", { x: x(p10), y: 16, width: Math.max(2, x(p90) - x(p10)), height: 14, rx: 4, class: "band" }),
    svg("path", { d: `M${x(p50)} 10V36`, class: "mark" }),
    text(0, 50, words[0]), text(WIDTH, 50, words[1], "end"),
  );
}

/** A value over its limit on a logarithmic bar of a factor of a hundred either way; in colour beyond `fair`. */
export function ratio(value, fair, words) {
  const x = (r) => (WIDTH * Math.min(Math.max(Math.log10(r) + 0.3, 0), 2.3)) / 2.3;
  return picture(
    svg("rect", { x: 0, y: 16, width: WIDTH, height: 14, rx: 4, class: "rail" }),
    svg("rect", { x: 0, y: 16, width: Math.max(3, x(value)), height: 14, rx: 4, class: value > fair ? "warnbar" : "bar" }),
    svg("path", { d: `M${x(1)} 10V36`, class: "mark" }),
    text(x(1) + 4, 48, words[0]), text(WIDTH, 48, words[1], "end"),
  );
}

/** Up to three rows, each a share of one with its name. */
export function bars(rows) {
  return picture(...rows.slice(0, 3).flatMap(([name, share], i) => [
    svg("rect", { x: 0, y: 2 + 17 * i, width: Math.max(2, share * 90), height: 10, class: i ? "band" : "bar" }),
    text(98, 11 + 17 * i, name),
  ]));
}

const text = (x, y, words, anchor = "start") => svg("text", { x, y, "text-anchor": anchor }, words);
