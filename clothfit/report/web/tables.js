// Tables: values, models and steps that were tried, fits side by side.

import { make } from "clothfit/drawing";
import { buttons } from "clothfit/save";

const text = (cell) => (Array.isArray(cell) ? cell[0] : cell);
const LONG = 16;  // characters from which on a text may be broken into lines
const number = (cell) => (Array.isArray(cell) ? cell[1] : cell);

const entry = (cell) => make("td", { class: typeof cell === "string" && cell.length > LONG ? "long" : "" }, text(cell));

/** A card with a table {id, title, heads, rows, note}; a cell is a text, or [text, number]. */
export function tableCard({ id, title, heads, rows, note }) {
  const head = make("tr", {}, ...heads.map((name) => make("th", { scope: "col" }, name)));
  const body = rows.map(([first, ...rest]) => make("tr", {}, make("th", { scope: "row" }, text(first)),
                                                   ...rest.map(entry)));
  const table = make("table", {}, make("thead", {}, head), make("tbody", {}, ...body));
  const saved = buttons(id, () => [heads, ...rows.map((row) => row.map(number))]);
  const frame = make("div", { class: "wide", tabindex: "0", role: "region", "aria-label": title }, table);
  const parts = [make("h2", {}, title, saved), frame];
  if (note) parts.push(make("p", { class: "quiet" }, note));
  return make("section", { class: "card table", id: `table-${id}` }, ...parts);
}
