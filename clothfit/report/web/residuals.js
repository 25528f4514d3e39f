// What is left between the fitted motion and its target: over the cloth, and in time.

import { markerCard } from "clothfit/captures";
import { key, lineChart } from "clothfit/charts";
import { make } from "clothfit/drawing";
import { mapOf } from "clothfit/parameters";
import { buttons } from "clothfit/save";
import { scaleOf } from "clothfit/shading";
import { called, lengthUnit } from "clothfit/words";

const AXES = ["x", "y", "z"];

/** The cards of the residuals; `residuals` has mean (3 lists, m), of_vertices and known (one each per vertex). */
export function residualCards(residuals, curve, mesh) {
  const cards = [overTheCloth(residuals, mesh), inTime(residuals, curve)];
  return residuals.markers?.length ? [...cards, markerCard(residuals, mesh)] : cards;
}

/** A map of each object, with the root mean square of the residuals of each vertex. */
function overTheCloth({ of_vertices: all, known }, mesh) {
  const [size, unit] = lengthUnit(all.reduce((most, value) => Math.max(most, value), 0));
  const maps = [];
  mesh.vertex_counts.forEach((count, object) => {
    const first = mesh.firsts[object];
    const [values, shown] = [all, known].map((array) => array.slice(first, first + count));
    if (!shown.some(Boolean)) return;
    const block = { object, of: "vertex", title: "Residuals", unit, values: values.map((value) => value / size), shown };
    maps.push(mapOf(block, mesh, scaleOf(block.values.map((value, i) => (shown[i] ? value : NaN)), unit)));
  });
  const rows = () => [["vertex", "rms_residual_m"], ...Array.from(all, (value, i) => [i, known[i] ? value : null])];
  const saved = buttons("residuals", rows, maps[0]?.querySelector("canvas"));
  const note = make("p", { class: "quiet" }, `Root mean square over ${called.near ? `the ${called.near}` : "all frames"}, on the cloth as it lies at the start.`);
  return make("section", { class: "card", id: "residuals" }, make("h2", {}, "Residuals over the cloth", saved), ...maps, note);
}

/** The mean residual of each frame by component: where it is not 0, the cloth as a whole lags or drifts. */
function inTime({ mean }, curve) {
  const lines = AXES.map((name, i) => ({ name, values: mean[i], kind: `axis-${name}` }));
  const chart = lineChart(curve, lines, "Mean residual of each frame by component");
  const rows = () => [["time_s", ...AXES.map((name) => `mean_${name}_m`)],
                      ...curve.times.map((time, k) => [time, ...mean.map((part) => part[k])])];
  return make("section", { class: "card", id: "drift" }, make("h2", {}, "Mean residual in time", buttons("mean-residual", rows, chart)),
              chart, key(...AXES.map((name) => [`axis-${name}`, name])),
              make("p", { class: "quiet" }, `${called.own[0].toUpperCase()}${called.own.slice(1)} minus ${called.goal}. Away from 0 the whole cloth lags, or drifts aside.`));
}
