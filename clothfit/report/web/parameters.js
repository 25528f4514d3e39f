// The fitted parameters: a map on the cloth, a histogram, the sorted values with their intervals.

import { key } from "clothfit/charts";
import { css, gradient, painted } from "clothfit/colours";
import { make, path, svg } from "clothfit/drawing";
import { buttons } from "clothfit/save";
import { scaleOf } from "clothfit/shading";
import { short, ticks } from "clothfit/words";

const WIDTH = 400, BARS = 28, MOST_POINTS = 400;
const MOST_SPRINGS = 6000;  // that a map draws as lines

/** A card for a block of parameters; `mesh` are the arrays of the whole scene. */
export function parameterCard(block, mesh) {
  const scale = scaleOf(block.values.map((value, i) => (block.shown[i] ? value : NaN)), block.unit);
  const drawn = block.object === null || block.mode !== "L" ? null : mapCard(block, mesh, scale);
  const sorted = sortedChart(block, scale);
  const entries = [["line", "fitted, sorted"], ["given", block.trial ? "truth" : "the scene's value"]];
  if (block.low.some(Number.isFinite)) entries.push(["band", "95 % interval"]);
  const name = `${block.owner}-${block.title}`.replace(/[^\w]+/g, "-").toLowerCase();
  const heads = [block.of, `fitted_${block.unit}`, block.trial ? "truth" : "scene", "low", "high"];
  const rows = () => [heads, ...Array.from(block.values, (value, i) =>
    [i, value, block.given[i], ...[block.low[i], block.high[i]].map((end) => (Number.isFinite(end) ? end : null))])];
  const head = make("h2", {}, block.title, make("small", {}, owner(block)),
                    buttons(name, rows, drawn?.querySelector("canvas") ?? sorted));
  const parts = [head, ...(drawn ? [drawn] : []), sorted, key(...entries), histogram(block, scale)];
  const lost = block.shown.reduce((sum, flag) => sum + (flag ? 0 : 1), 0);
  if (lost) {
    const text = `${lost} of ${block.values.length} are not shown by any motion and keep their start; they are left out.`;
    parts.push(make("p", { class: "quiet" }, text));
  }
  return make("section", { class: "card" }, ...parts);
}

/** The owner of the values, and their number. */
const owner = (block) => `${block.owner} · ${block.values.length} values${block.mode === "L" ? `, one per ${block.of}` : ""}`;

/** The map of a block; of too many springs for lines, the mean of the springs at each vertex. */
function mapCard(block, mesh, scale) {
  if (block.of !== "spring" || block.values.length <= MOST_SPRINGS) return map(block, mesh, scale);
  const means = meansOfSprings(block, mesh);
  return map(means, mesh, scaleOf(means.values, block.unit), "mean of the springs at a vertex");
}

/** The block with one value for each vertex: the mean of the springs there. */
function meansOfSprings(block, mesh) {
  const first = mesh.firsts[block.object], start = mesh.springFirsts[block.object];
  const values = new Float32Array(mesh.vertex_counts[block.object]), count = new Uint32Array(values.length);
  for (let s = 0; s < block.values.length; s++) {
    if (!block.shown[s]) continue;
    for (const vertex of mesh.springs.subarray(2 * (start + s), 2 * (start + s) + 2)) {
      values[vertex - first] += block.values[s];
      count[vertex - first]++;
    }
  }
  return { ...block, of: "vertex", values: values.map((sum, i) => sum / count[i]), shown: count };
}

/** The object as it lies at the start, along the two directions in which it is widest, coloured by its values. */
export const mapOf = (block, mesh, scale) => map(block, mesh, scale);

function map(block, mesh, scale, note = "") {
  const first = mesh.firsts[block.object], count = mesh.vertex_counts[block.object];
  const points = flattened(mesh.start.subarray(3 * first, 3 * (first + count)));
  const canvas = make("canvas", { class: "map", role: "img", "aria-label": `${block.title} on the cloth as it lies at the start` });
  const wide = Math.max(...points.spread);
  const [w, h] = points.spread.map((side) => Math.max(side / wide, 0.12));
  Object.assign(canvas, { width: 720, height: Math.round((700 * h) / w) + 20 });
  const size = Math.min(700 / (points.spread[0] || 1), (canvas.height - 20) / (points.spread[1] || 1e-9));
  const place = (i) => [canvas.width / 2 + size * points.x[i], canvas.height / 2 - size * points.y[i]];
  const pen = canvas.getContext("2d");
  const tint = (i) => css("rising", scale.share(block.values[i]));
  if (block.of !== "spring" && block.of !== "vertex") return null;
  const bar = make("span", { class: "bar" });
  painted(() => {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    bar.style.background = gradient("rising");
    if (block.of === "spring") drawSprings(pen, block, mesh, place, first, tint);
    else drawFaces(pen, block, mesh, place, first, scale, tint);
  });
  const labels = make("span", { class: "labels" }, ...scale.labels.map((text) => make("span", {}, text)));
  const unit = make("span", { class: "unit" }, block.unit), remark = note ? [make("span", {}, note)] : [];
  return make("figure", {}, canvas, make("figcaption", { class: "scale" }, bar, labels, unit, ...remark));
}

function drawFaces(pen, block, mesh, place, first, scale, tint) {
  const last = first + mesh.vertex_counts[block.object];
  for (let t = 0; t < mesh.triangles.length; t += 3) {
    const corners = Array.from(mesh.triangles.subarray(t, t + 3));
    if (corners[0] < first || corners[0] >= last) continue;
    const known = corners.filter((i) => block.shown[i - first]);
    const sum = known.reduce((sum, i) => sum + scale.share(block.values[i - first]), 0);
    pen.lineWidth = 1;
    pen.fillStyle = pen.strokeStyle = known.length ? css("rising", sum / known.length) : "#8885";
    pen.beginPath();
    corners.forEach((i) => pen.lineTo(...place(i - first)));
    pen.closePath();
    pen.fill();
    pen.stroke();
  }
  const radius = Math.min(9, 120 / Math.sqrt(block.values.length));
  for (let i = 0; i < block.values.length && radius > 3; i++) {
    pen.fillStyle = block.shown[i] ? tint(i) : "#8888";
    pen.beginPath();
    pen.arc(...place(i), radius, 0, 2 * Math.PI);
    pen.fill();
  }
}

function drawSprings(pen, block, mesh, place, first, tint) {
  const start = mesh.springFirsts[block.object];
  pen.lineWidth = Math.min(7, 90 / Math.sqrt(block.values.length));
  pen.lineCap = "round";
  for (let s = 0; s < block.values.length; s++) {
    const at = 2 * (start + s);
    pen.strokeStyle = block.shown[s] ? tint(s) : "#8885";
    pen.beginPath();
    pen.moveTo(...place(mesh.springs[at] - first));
    pen.lineTo(...place(mesh.springs[at + 1] - first));
    pen.stroke();
  }
}

/** Places along the two world axes in which points spread most, with the middle at 0; a level cloth is seen from above. */
function flattened(x) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < x.length; i++) {
    low[i % 3] = Math.min(low[i % 3], x[i]);
    high[i % 3] = Math.max(high[i % 3], x[i]);
  }
  const spread = high.map((value, c) => value - low[c]);
  const thin = spread.indexOf(Math.min(...spread));
  const [a, b] = [[2, 1], [0, 2], [0, 1]][thin];
  const along = (c, sign) => Float32Array.from({ length: x.length / 3 }, (_, i) => sign * (x[3 * i + c] - (low[c] + high[c]) / 2));
  return { x: along(a, a === 0 ? -1 : 1), y: along(b, 1), spread: [spread[a], spread[b]] };
}

/** The values in order of size, with their intervals and the scene's values. */
function sortedChart(block, scale) {
  const order = Array.from(block.values.keys()).filter((i) => block.shown[i]).sort((a, b) => block.values[a] - block.values[b]);
  const every = Math.ceil(order.length / MOST_POINTS) || 1;
  const chosen = order.filter((_, i) => i % every === 0);
  const bounds = [block.values, block.given, block.low, block.high]
    .flatMap((values) => chosen.map((i) => values[i]).filter(Number.isFinite));
  const all = scaleOf(Float32Array.from(bounds));
  const [left, right, top, bottom] = [66, WIDTH - 12, 8, 128];
  const across = (k) => left + ((k + 0.5) / chosen.length) * (right - left);
  const up = (value) => bottom - (all.high > all.low ? all.share(Math.min(value, all.high)) : 0.5) * (bottom - top);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} 144`, class: "chart", role: "img",
                               "aria-label": `${block.title}: fitted values in order of size` });
  const marks = all.wide ? [all.low, Math.sqrt(all.low * all.high), all.high] : ticks(all.low, all.high, 3);
  for (const value of all.high > all.low ? marks : [all.low]) {
    picture.append(svg("line", { x1: left, x2: right, y1: up(value), y2: up(value), class: "rule" }),
                   svg("text", { x: left - 6, y: up(value) + 3.5, class: "tick end" }, short(value, 2)));
  }
  const known = chosen.map((i, k) => [i, k]).filter(([i]) => Number.isFinite(block.low[i]));
  if (known.length) {
    const upper = known.map(([i, k]) => [across(k), up(block.high[i])]);
    const lower = known.map(([i, k]) => [across(k), up(Math.max(block.low[i], all.low))]).reverse();
    picture.append(svg("path", { d: `${path([...upper, ...lower])}Z`, class: "band" }));
  }
  picture.append(...chosen.map((i, k) => svg("circle", { cx: across(k), cy: up(block.given[i]), r: 1.5, class: "given" })));
  picture.append(svg("path", { d: path(chosen.map((i, k) => [across(k), up(block.values[i])])), class: "line" }),
                 svg("text", { x: (left + right) / 2, y: 141, class: "name middle" }, "in order of size"),
                 svg("text", { class: "name middle", transform: `translate(9 ${(top + bottom) / 2}) rotate(-90)` }, block.unit));
  return picture;
}

/** A histogram of the values. */
function histogram(block, scale) {
  const counts = new Uint32Array(BARS), given = new Uint32Array(BARS);
  const shown = Array.from(block.values.keys()).filter((i) => block.shown[i]);
  const both = scaleOf(Float32Array.from(shown.flatMap((i) => [block.values[i], block.given[i]])), block.unit);
  const bar = (value) => Math.min(Math.floor(both.share(value) * BARS), BARS - 1);
  for (const i of shown) {
    counts[bar(block.values[i])]++;
    given[bar(block.given[i])]++;
  }
  const most = Math.max(...counts, ...given, 1);
  const [left, right, top, bottom] = [66, WIDTH - 12, 6, 84], width = (right - left) / BARS;
  const high = (count) => bottom - (count / most) * (bottom - top);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} 118`, class: "chart", role: "img",
                               "aria-label": `${block.title}: how many values lie where` });
  counts.forEach((count, k) => {
    const bar = svg("rect", {
      x: left + k * width + 0.5, y: high(count), width: width - 1, height: bottom - high(count), class: "column" });
    painted(() => bar.setAttribute("fill", css("rising", scale.share(valueAt(both, (k + 0.5) / BARS)))));
    picture.append(bar);
  });
  const steps = Array.from(given).flatMap((count, k) => {
    const [x0, x1, y] = [left + k * width, left + (k + 1) * width, high(count)];
    return count ? [[x0, bottom], [x0, y], [x1, y], [x1, bottom]] : [null];
  });
  picture.append(svg("path", { d: path(steps), class: "line given" }),
                 svg("line", { x1: left, x2: right, y1: bottom, y2: bottom, class: "axis" }));
  both.labels.forEach((text, k) => picture.append(svg("text", {
    x: left + (k * (right - left)) / 2, y: bottom + 14, class: `tick ${["", "middle", "end"][k]}` }, text)));
  picture.append(svg("text", { x: (left + right) / 2, y: 114, class: "name middle" }, block.unit),
                 svg("text", { x: left - 6, y: top + 6, class: "tick end" }, String(most)));
  return picture;
}

function valueAt(scale, share) {
  return scale.wide ? scale.low * (scale.high / scale.low) ** share : scale.low + share * (scale.high - scale.low);
}
