// The residuals of each marker of a capture in each frame, with its gaps and weights.

import { css, gradient, painted } from "clothfit/colours";
import { make } from "clothfit/drawing";
import { buttons } from "clothfit/save";
import { scaleOf } from "clothfit/shading";
import { lengthUnit } from "clothfit/words";

const WIDE = 720, LEFT = 60, GAP = "#888a";

/** A card with a row for each marker, a column for each frame; `of_markers` (M, F) is in m, below 0 in gaps. */
export function markerCard({ markers, marker_times: times, of_markers: all, weights }, mesh) {
  const count = times.length, tall = Math.min(Math.max(Math.floor(480 / markers.length), 3), 16);
  const [size, unit] = lengthUnit(all.reduce((most, value) => Math.max(most, value), 0));
  const scale = scaleOf(Array.from(all, (value) => (value < 0 ? NaN : value / size)), unit);
  const label = "Residuals of each marker in each frame";
  const canvas = make("canvas", { class: "map", role: "img", "aria-label": label });
  Object.assign(canvas, { width: WIDE, height: tall * markers.length + 20 });
  const pen = canvas.getContext("2d"), bar = make("span", { class: "bar" });
  const across = (WIDE - LEFT) / count;
  painted(() => {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    bar.style.background = gradient("rising");
    markers.forEach((_, m) => {
      for (let k = 0; k < count; k++) {
        const value = all[m * count + k];
        pen.globalAlpha = value < 0 || !weights ? 1 : 0.15 + 0.85 * weights[m * count + k];
        pen.fillStyle = value < 0 ? GAP : css("rising", scale.share(value / size));
        pen.fillRect(LEFT + k * across, m * tall, Math.ceil(across), value < 0 ? Math.max(tall / 4, 1) : tall - 1);
      }
    });
    lettered(pen, markers, times, mesh, tall);
  });
  const rows = () => [["marker_of_vertex", ...times.map((time) => `residual_m at ${time} s`)],
                      ...markers.map((vertex, m) => [vertex, ...Array.from(all.subarray(m * count, (m + 1) * count), (value) => (value < 0 ? null : value))])];
  const labels = make("span", { class: "labels" }, ...scale.labels.map((text) => make("span", {}, text)));
  const figure = make("figure", {}, canvas, make("figcaption", { class: "scale" }, bar, labels, make("span", { class: "unit" }, unit)));
  const note = `A row for each marker, a column for each frame; thin grey lines are gaps${weights ? ", pale colours small weights" : ""}.`;
  return make("section", { class: "card", id: "markers" }, make("h2", {}, "Residuals by marker and frame", buttons("markers", rows, canvas)),
              figure, make("p", { class: "quiet" }, note));
}

/** The numbers of vertices beside their rows, as many as there is room for, and the first and last time below. */
function lettered(pen, markers, times, mesh, tall) {
  Object.assign(pen, { globalAlpha: 1, fillStyle: getComputedStyle(document.body).color, font: "11px sans-serif" });
  const every = Math.ceil(12 / tall), below = tall * markers.length + 14;
  pen.textAlign = "right";
  markers.forEach((vertex, m) => {
    const object = mesh.firsts.findLastIndex((first) => first <= vertex);
    const name = mesh.vertex_counts.length > 1 ? `${object}: ${vertex - mesh.firsts[object]}` : String(vertex);
    if (m % every === 0) pen.fillText(name, LEFT - 6, m * tall + Math.max(tall - 3, 9));
  });
  pen.fillText(`${Number(times[times.length - 1].toPrecision(4))} s`, WIDE, below);
  pen.textAlign = "left";
  pen.fillText(`${Number(times[0].toPrecision(4))} s`, LEFT, below);
}
