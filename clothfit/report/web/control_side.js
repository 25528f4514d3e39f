// The column beside a controlled motion: its keys, the distance from each of them, and what each step takes.

import { axisOf, frame, key, nearest, onDrag } from "clothfit/charts";
import { make, path, svg } from "clothfit/drawing";
import { card, commandLines, drawn, summary } from "clothfit/side";
import { tableCard } from "clothfit/tables";

const FEW = 4;  // keys that have a line each

/** Fill the column; `jump(time)` moves the player. Returns a function that moves the cursors to a time and returns the
 * distance from the next key there, that of the motion beside, and the largest force, N. */
export function fillControlSide(side, content, jump) {
  const { control: { chart, times }, curve, beside, tables } = content;
  const far = distances(chart, times, curve, jump);
  const effort = steps(chart.effort, "effort of a step, N² s", "Effort of each step", chart.times, times, jump);
  const force = steps(chart.force, "largest force, N", "Largest force on a vertex in each step", chart.times, times, jump);
  side.append(summary(content), ...tables.map(tableCard));
  side.append(drawn("distance", "Distance from the keys", () => distanceRows(chart), far.element, far.key,
                    make("p", { class: "quiet" }, "Dashed lines are the times of the keys. Press or drag in a chart to go to a frame.")));
  const rows = (name, values) => () => [["time_s", name], ...chart.times.map((time, i) => [time, values[i]])];
  if (chart.effort.some((value) => value > 0)) {
    side.append(drawn("effort", "Effort over time", rows("effort_N2s", chart.effort), effort.element));
    side.append(drawn("force", "Largest force over time", rows("force_N", chart.force), force.element));
  }
  side.append(commandLines(content));
  return (time) => {
    for (const each of [far, effort, force]) each.move(time);
    const at = nearest(curve.times, time);
    return { rmse: curve.rmse[at], others: beside.map((each) => each.curve.rmse[at]), force: chart.force[nearest(chart.times, time)] };
  };
}

/** Lines at the times of the keys, and one that moves; returns the function that moves it. */
function marked(box, due, jump) {
  box.back.append(...due.map((time) => svg("line", { x1: box.across(time), x2: box.across(time), y1: box.y1, y2: box.y0, class: "due" })));
  const cursor = svg("line", { y1: box.y1, y2: box.y0, class: "cursor" });
  box.front.append(cursor);
  onDrag(box.picture, (place) => jump(box.timeAt(place)));
  return (time) => { for (const end of ["x1", "x2"]) cursor.setAttribute(end, box.across(time)); };
}

function distances({ times, distances: all, at, names }, due, curve, jump) {
  const alone = all.length > FEW;
  const lines = alone ? [["the next key", curve.times, curve.rmse]] : all.map((values, k) => [names[k], times, values]);
  const y = axisOf(lines.flatMap(([, , values]) => values), true, true);
  const box = frame({ x: { low: times[0], high: times[times.length - 1] }, y, xTitle: "time, s", yTitle: "distance",
                      label: "Root mean square distance from the keys over time" });
  const kinds = lines.map((_, k) => (k === 0 ? "line" : `other-${(k - 1) % 4}`));
  const up = (value) => box.up(Math.max(value, y.low));
  box.front.append(...lines.map(([, own, values], k) => svg("path", {
    d: path(values.map((value, i) => (value > 0 ? [box.across(own[i]), up(value)] : null))), class: `line ${kinds[k]}` })));
  box.front.append(...all.flatMap((values, k) => (values[at[k]] > 0 || y.log ? [svg("circle", {
    cx: box.across(times[at[k]]), cy: up(values[at[k]]), r: 3.5, class: "given" })] : [])));
  const move = marked(box, due, jump);
  return { element: box.picture, move, key: key(...lines.map(([name], k) => [kinds[k], name]), ["given", "at its time"]) };
}

/** Values of steps, from 0 upwards, as an area. */
function steps(values, yTitle, label, times, due, jump) {
  const high = 1.08 * Math.max(...values) || 1;
  const y = { ...axisOf(values, false), low: 0, high, log: false };
  const box = frame({ x: { low: times[0], high: times[times.length - 1] }, y, xTitle: "time, s", yTitle, label });
  const corners = values.slice(0, -1).flatMap((value, i) => [[times[i], value], [times[i + 1], value]]);
  const line = path(corners.map(([time, value]) => [box.across(time), box.up(value)]));
  box.front.append(svg("path", { d: `${line}L${box.x1} ${box.y0}L${box.x0} ${box.y0}Z`, class: "area force" }),
                   svg("path", { d: line, class: "line force" }));
  return { element: box.picture, move: marked(box, due, jump) };
}

function distanceRows({ times, distances: all, names }) {
  return [["time_s", ...names.map((name) => `distance_m ${name}`)], ...times.map((time, i) => [time, ...all.map((values) => values[i])])];
}

/** Marks of the keys on the slider's track; a press goes there. `goTo(k)` moves the player to key k. */
export function markTrack(track, { due, times }, last, goTo) {
  track.append(...due.map((frame, k) => {
    const title = `Key at ${Number(times[k].toPrecision(4))} s`;
    const mark = make("button", { type: "button", class: "due-mark", title, "aria-label": title, tabindex: "-1",
                                  style: `left: calc(8px + (100% - 16px) * ${frame / Math.max(last, 1)})` });
    mark.addEventListener("click", () => goTo(k));
    return mark;
  }));
}
