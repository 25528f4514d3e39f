// The column of charts and numbers beside the motion.

import { costChart, errorChart, key } from "clothfit/charts";
import { make } from "clothfit/drawing";
import { parameterCard } from "clothfit/parameters";
import { residualCards } from "clothfit/residuals";
import { buttons } from "clothfit/save";
import { tableCard } from "clothfit/tables";

const FIRST = ["fits", "values"];  // tables that stand before the charts

export const card = (title, ...parts) => make("section", { class: "card" }, make("h2", {}, title), ...parts);
export const drawn = (name, title, rows, chart, ...parts) =>
  make("section", { class: "card" }, make("h2", {}, title, buttons(name, rows, chart)), chart, ...parts);

/** Fill the column; `jump(time)` moves the player. Returns a function that moves the cursor to a time and returns the
 * error there. */
export function fillSide(side, content, mesh, blocks, jump) {
  const { curve, beside, history, tables } = content;
  side.append(summary(content), ...tables.filter(({ id }) => FIRST.includes(id)).map(tableCard));
  const error = errorChart(curve, beside, jump);
  const entries = [["line", "root mean square"], ["quiet", "largest"], ...beside.map(({ name }, i) => [`other-${i % 4}`, name])];
  side.append(drawn("error", "Error per frame", () => errorRows(curve, beside), error.element, key(...entries),
                    make("p", { class: "quiet" }, "Press or drag in the chart to go to a frame.")));
  side.append(...blocks.map((block) => parameterCard(block, mesh)));
  const more = [...residualCards(content.residuals, curve, mesh)];
  if (history.length > 1) {
    const rows = () => [["evaluations", `cost_${content.cost_unit}`, "rmse_m", "seconds"], ...history];
    more.push(drawn("cost", "Cost per evaluation", rows, costChart(history, content.cost_unit)));
  }
  more.push(...tables.filter(({ id }) => !FIRST.includes(id)).map(tableCard), commandLines(content));
  side.append(make("details", { class: "more" }, make("summary", {}, "For experts: residuals, the course of the fit, how to repeat it"), ...more));
  return error.move;
}

export function summary(content) {
  const rows = content.facts.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
  const parts = [make("dl", { class: "facts" }, ...rows)];
  parts.push(make("ul", { class: "notes" }, ...content.remarks.map((text) => make("li", {}, text))));
  return card("Summary", ...parts);
}

function errorRows({ times, rmse, largest }, beside) {
  const heads = ["time_s", "rmse_m", "largest_m", ...beside.map(({ name }) => `rmse_m ${name}`)];
  return [heads, ...times.map((time, i) => [time, rmse[i], largest[i], ...beside.map(({ curve }) => curve.rmse[i])])];
}

/** The line on which the eye falls first, and the warnings under it. */
export function fillHeadline(place, { level, text, next, warnings }) {
  place.className = `verdict ${level}`;
  place.replaceChildren(make("p", { class: "line" }, make("span", { class: "sign", "aria-hidden": "true" }), text));
  if (next) place.append(make("p", { class: "next" }, make("b", {}, "Next: "), next));
  if (warnings.length) place.append(make("ul", {}, ...warnings.map((each) => make("li", {}, each))));
}

export function commandLines(content) {
  const digests = content.inputs.map(([name, digest]) => make("div", {}, `${name} `, make("code", {}, digest)));
  const version = `clothfit ${content.version}${digests.length ? "; SHA-256 of what was read:" : ""}`;
  return card(
    "To repeat it",
    make("div", { class: "commands" }, ...content.commands.map((text) => make("pre", { tabindex: "0" }, text))),
    make("div", { class: "digests" }, make("div", {}, version), ...digests),
  );
}
