// The motions that stand side by side: the fitted one, that before the fit, other fits.

import { make } from "clothfit/drawing";
import { length } from "clothfit/words";

const MOST = 4;  // panes that are shown at first
const ROOMY = 640;  // pixels: a narrower picture shows the fitted motion alone at first

/** The cells of `count` panes in a picture: side by side, or one above the other in a tall one. */
export function cells(count, width, height) {
  const number = Math.max(count, 1), across = number === 1 || width >= height;
  return Array.from({ length: number }, (_, k) => (across
    ? { left: (k * width) / number, top: 0, width: width / number, height }
    : { left: 0, top: (k * height) / number, width, height: height / number }));
}

/** Make the panes of motions {name, cloth, shading}; the first is the fitted one. `chips` gets a button for each other. */
export function panesOf(motions, chips, room) {
  return motions.map((motion, k) => {
    const on = k === 0 || (room >= ROOMY && k < MOST);
    if (k === 0) return { ...motion, on };
    const button = make("button", { type: "button", class: `chip pane other-${(k - 1) % 4}`, "aria-pressed": on,
                                    title: `Beside it: ${motion.name}` }, motion.name);
    chips.append(button);
    return { ...motion, on, button };
  });
}

/** Let the buttons show and hide panes; `changed` is called then. */
export function listenToPanes(panes, changed) {
  for (const pane of panes.slice(1)) {
    pane.button.addEventListener("click", () => {
      pane.on = !pane.on;
      pane.button.setAttribute("aria-pressed", pane.on);
      changed();
    });
  }
}

/** Write under each pane what it is, and its error now; nothing where there is only one. */
export function namePanes(place, panes, cellsNow, errors) {
  const shown = panes.map((pane, k) => [pane, errors[k]]).filter(([pane]) => pane.on);
  place.replaceChildren(...(shown.length < 2 ? [] : shown.map(([pane, error], k) => {
    const { left, top, width, height } = cellsNow[k];
    const text = typeof error === "number" ? `RMSE ${length(error)}` : "no error here";
    const style = `left:${left}px;top:${top}px;width:${width}px;height:${height}px`;
    return make("div", { class: "pane-name", style }, make("b", {}, pane.name), ` ${text}`);
  })));
}
