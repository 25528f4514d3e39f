// The column of charts and numbers beside the motion.

import { costChart, errorChart, key } from "clothfit/charts";
import { make } from "clothfit/drawing";
import { parameterCard } from "clothfit/parameters";

const card = (title, ...parts) => make("section", { class: "card" }, make("h2", {}, title), ...parts);

/** Fill the column; `jump(time)` moves the player. Returns a function that moves the cursor to a time and returns the
 * error there. */
export function fillSide(side, content, mesh, blocks, jump) {
  side.append(summary(content));
  const error = errorChart(content.curve, jump);
  side.append(card("Error per frame", error.element, key(["line", "root mean square"], ["quiet", "largest"]),
                   make("p", { class: "quiet" }, "Press or drag in the chart to go to a frame.")));
  if (content.history.length > 1) side.append(card("Cost per evaluation", costChart(content.history)));
  side.append(...blocks.map((block) => parameterCard(block, mesh)));
  side.append(commandLines(content));
  return error.move;
}

function summary(content) {
  const rows = content.facts.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
  const parts = [make("dl", { class: "facts" }, ...rows)];
  if (content.deviations.length && content.names.target === null) parts.push(deviations(content.deviations));
  const notes = [["loud", content.notes], ["calm", content.remarks]].flatMap(([kind, texts]) =>
    texts.map((text) => make("li", { class: kind }, text)));
  parts.push(make("ul", { class: "notes" }, ...notes));
  return card("Summary", ...parts);
}

function deviations(rows) {
  const heads = ["off the truth", "count", "median", "largest"].map((name) => make("th", { scope: "col" }, name));
  const body = rows.map((row) => make("tr", {}, ...row.map((cell) => make("td", {}, cell))));
  const table = make("table", {}, make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...body));
  return make("div", { class: "wide" }, table);
}

function commandLines(content) {
  const digests = content.inputs.map(([name, digest]) => make("div", {}, `${name} `, make("code", {}, digest)));
  const version = `clothfit ${content.version}${digests.length ? "; SHA-256 of what was read:" : ""}`;
  return card(
    "To repeat it",
    make("div", { class: "commands" }, ...content.commands.map((text) => make("pre", { tabindex: "0" }, text))),
    make("div", { class: "digests" }, make("div", {}, version), ...digests),
  );
}
