// Scales of colours: suited to every kind of colour vision, their brightness rising or falling all the way, and every
// colour legible (a contrast of at least 3 to 1) on the cards of a light page, or of a dark one.

const STOPS = {
  light: {
    // from quiet to loud: for errors, masses, stiffnesses
    rising: ["#1b9a86", "#2382b4", "#4763c2", "#6a3fb0", "#7c1d80", "#560b3c"],
    // from pressed to pulled, the middle is rest
    both: ["#123f8c", "#3f78c4", "#878c96", "#cf6a24", "#8e1f12"],
  },
  dark: {
    rising: ["#6f6bd6", "#4b93d8", "#33b8a6", "#8bd069", "#f5d84a", "#fdf4c4"],
    both: ["#7fb4ff", "#5b8fd6", "#8b93a3", "#e08a4a", "#ff9d83"],
  },
};

const repaints = [];

/** Call a function now, and again whenever the page turns dark or light. */
export function painted(paint) {
  repaints.push(paint);
  paint();
}

/** The page has turned dark or light: paint all that has colours again. */
export const repaint = () => repaints.forEach((paint) => paint());

const stopsOf = (scale) => STOPS[document.documentElement.dataset.theme === "dark" ? "dark" : "light"][scale];
const parsed = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** The colour at 0 … 1 of a scale, three numbers 0 … 255. */
export function colour(scale, share) {
  const stops = stopsOf(scale);
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const below = Math.min(Math.floor(place), stops.length - 2);
  const [a, b] = [parsed(stops[below]), parsed(stops[below + 1])];
  return a.map((value, i) => value + (b[i] - value) * (place - below));
}

/** The same as CSS writes it. */
export const css = (scale, share) => `rgb(${colour(scale, share).map(Math.round).join(" ")})`;

/** A scale as a CSS gradient to the right. */
export const gradient = (scale) => `linear-gradient(to right, ${stopsOf(scale).join(", ")})`;

/** A scale as 256 colours in linear light, as shaders have them: Float32Array (256 · 3). */
export function table(scale) {
  const found = new Float32Array(3 * 256);
  for (let i = 0; i < 256; i++) {
    colour(scale, i / 255).forEach((value, c) => {
      const s = value / 255;
      found[3 * i + c] = s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
    });
  }
  return found;
}
