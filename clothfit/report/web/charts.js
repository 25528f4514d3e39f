// Charts of lines as SVG: the error of each frame, the cost of each evaluation.

import { make, path, svg } from "clothfit/drawing";
import { called, decades, length, lengthUnit, short, ticks } from "clothfit/words";

const WIDTH = 400, HEIGHT = 190;
const FRAME = { left: 66, right: 12, top: 20, bottom: 34 };
const LOG = 30;  // the axis is logarithmic where the largest value exceeds the lower quartile by more than this factor
const DEEPEST = 1e-8;  // the lowest value of such an axis, relative to the largest

/** A frame with axes; returns its elements and the functions that place values. */
export function frame({ x, y, xTitle, yTitle, label }) {
  const [x0, x1] = [FRAME.left, WIDTH - FRAME.right], [y0, y1] = [HEIGHT - FRAME.bottom, FRAME.top];
  const turn = y.log ? Math.log10 : (value) => value;
  const [low, high] = [turn(y.low), turn(y.high)];
  const across = (value) => x0 + ((value - x.low) / (x.high - x.low || 1)) * (x1 - x0);
  const up = (value) => y0 + ((turn(value) - low) / (high - low || 1)) * (y1 - y0);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "chart", role: "img", "aria-label": label });
  const back = svg("g"), front = svg("g");
  for (const value of y.log ? decades(y.low, y.high) : ticks(y.low, y.high, 4, y.size)) {
    back.append(
      svg("line", { x1: x0, x2: x1, y1: up(value), y2: up(value), class: "rule" }),
      svg("text", { x: x0 - 6, y: up(value) + 3.5, class: "tick end" }, y.name(value)),
    );
  }
  for (const value of ticks(x.low, x.high, 6)) {
    back.append(svg("text", { x: across(value), y: y0 + 14, class: "tick middle" }, short(value)));
  }
  back.append(
    svg("line", { x1: x0, x2: x1, y1: y0, y2: y0, class: "axis" }),
    svg("text", { x: (x0 + x1) / 2, y: HEIGHT - 4, class: "name middle" }, xTitle),
    svg("text", { x: 0, y: 0, class: "name middle", transform: `translate(9 ${(y0 + y1) / 2}) rotate(-90)` }, yTitle),
  );
  picture.append(back, front);
  const timeAt = (place) => x.low + ((place - x0) / (x1 - x0)) * (x.high - x.low);
  return { picture, back, front, across, up, timeAt, x0, x1, y0, y1 };
}

/** An axis for values above 0 (without null), in m where `metres`, with room at its ends; logarithmic if `always`, or
 * if the values differ much. */
export function axisOf(values, metres, always = false) {
  const known = values.filter((value) => value > 0);
  if (known.length === 0) return { low: 0, high: 1, log: false, name: short };
  const sorted = Float64Array.from(known).sort();
  const high = sorted[sorted.length - 1];
  const log = always || high / sorted[sorted.length >> 2] > LOG;
  const [size, unit] = metres && !log ? lengthUnit(high) : [1, metres ? "m" : ""];
  const low = 10 ** Math.floor(Math.log10(Math.max(sorted[0], high * DEEPEST)) + 0.05);
  const name = metres && log ? length : (value) => short(value / size);
  return { low: log ? low : 0, high: log ? high * 1.6 : high * 1.08, log, name, size, unit: log ? "" : unit };
}

/** The window of the fitted frames, and what is written over it. */
function windowed(box, until) {
  const edge = Math.min(box.across(until), box.x1);
  const [width, height] = [Math.max(edge - box.x0, 0), box.y0 - box.y1];
  if (!called.near) return;
  box.back.prepend(svg("rect", { x: box.x0, y: box.y1, width, height, class: "window" }));
  box.back.append(svg("text", { x: box.x0, y: box.y1 - 6, class: "mark" }, called.near));
  const after = Math.max(edge, box.x0 + 75) + 5;
  if (edge < box.x1 - 90) box.back.append(svg("text", { x: after, y: box.y1 - 6, class: "mark" }, called.far));
  if (edge < box.x1 - 1) box.back.append(svg("line", { x1: edge, x2: edge, y1: box.y1, y2: box.y0, class: "edge" }));
}

/** The error of each frame, with those of the motions beside it; a click calls `jump(time)`. Returns the element and the
 * function that moves its cursor. */
export function errorChart(curve, beside, jump) {
  const { times, rmse, largest, fitted_until: until } = curve;
  const others = beside.map((each) => each.curve.rmse);
  const y = axisOf([...rmse, ...largest, ...others.flat()], true);
  const x = { low: times[0], high: times[times.length - 1] };
  const box = frame({
    x, y, xTitle: "time, s", yTitle: y.unit ? `error, ${y.unit}` : "error",
    label: `Error of each frame: root mean square and largest distance to the ${called.goal}`,
  });
  windowed(box, until);
  const points = (values) => values.map((value, i) =>
    value === null || (y.log && value <= 0) ? null : [box.across(times[i]), box.up(Math.max(value, y.low))]);
  box.front.append(
    svg("path", { d: path(points(largest)), class: "line quiet" }),
    ...others.map((values, i) => svg("path", { d: path(points(values)), class: `line other-${i % 4}` })),
    svg("path", { d: path(points(rmse)), class: "line" }),
  );
  const cursor = svg("line", { y1: box.y1, y2: box.y0, class: "cursor" });
  const dot = svg("circle", { r: 3.5, class: "dot" });
  box.front.append(cursor, dot);
  const move = (time) => {
    const at = nearest(times, time), value = rmse[at], place = box.across(time);
    cursor.setAttribute("x1", place);
    cursor.setAttribute("x2", place);
    dot.setAttribute("visibility", value > 0 || (value === 0 && !y.log) ? "visible" : "hidden");
    dot.setAttribute("cx", place);
    dot.setAttribute("cy", value > 0 ? box.up(Math.max(value, y.low)) : box.y0);
    return { rmse: value, largest: largest[at], others: others.map((values) => values[at]) };
  };
  onDrag(box.picture, (place) => jump(box.timeAt(place)));
  return { element: box.picture, move };
}

/** Lines over time, m, around 0; `lines` are {values, kind}. */
export function lineChart(curve, lines, label) {
  const { times, fitted_until: until } = curve;
  const most = Math.max(...lines.map(({ values }) => values.reduce((high, v) => Math.max(high, Math.abs(v ?? 0)), 0))) || 1e-9;
  const [size, unit] = lengthUnit(most);
  const y = { low: -1.08 * most, high: 1.08 * most, log: false, size, name: (value) => short(value / size) };
  const box = frame({ x: { low: times[0], high: times[times.length - 1] }, y, xTitle: "time, s", yTitle: `residual, ${unit}`, label });
  windowed(box, until);
  box.front.append(...lines.map(({ values, kind }) => svg("path", {
    d: path(values.map((value, i) => (value === null ? null : [box.across(times[i]), box.up(value)]))), class: `line ${kind}` })));
  return box.picture;
}

/** The best cost after each evaluation, in its unit. */
export const costChart = (history, unit) => descentChart(history, {
  xTitle: "evaluations of cost and gradient", yTitle: unit ? `cost, ${unit}` : "cost", label: "Best cost after each evaluation",
});

/** The best of what falls in steps; a `history` has [evaluations or seconds, value]. */
export function descentChart(history, titles) {
  const y = { ...axisOf(history.map((point) => point[1]), false, true), name: (value) => short(value, 2) };
  const box = frame({ x: { low: 0, high: Math.max(history[history.length - 1][0], 1) }, y, ...titles });
  const points = [];
  let before = null;
  for (const [evaluations, cost] of history) {
    if (!(cost > 0)) continue;
    const place = [box.across(evaluations), box.up(Math.max(cost, y.low))];
    if (before) points.push([place[0], before[1]]);
    points.push((before = place));
  }
  box.front.append(svg("path", { d: path(points), class: "line" }));
  if (before) box.front.append(svg("circle", { cx: before[0], cy: before[1], r: 3.5, class: "dot" }));
  return box.picture;
}

/** Call `moved` with the place, in units of the picture, where a pointer is pressed or dragged. */
export function onDrag(picture, moved) {
  const report = (event) => {
    const box = picture.getBoundingClientRect();
    moved(((event.clientX - box.left) / box.width) * WIDTH);
  };
  picture.classList.add("live");
  picture.addEventListener("pointerdown", (event) => {
    picture.setPointerCapture(event.pointerId);
    report(event);
  });
  picture.addEventListener("pointermove", (event) => { if (event.buttons) report(event); });
}

export function nearest(times, time) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  return Math.abs(times[high] - time) < Math.abs(times[low] - time) ? high : low;
}

/** The key of a chart: a line of text with the colours of its lines. */
export function key(...entries) {
  const parts = entries.map(([kind, text]) => make("span", { class: "entry" }, make("i", { class: `swatch ${kind}` }), text));
  return make("p", { class: "key" }, ...parts);
}
