// Scales of colours: perceptually even, suited to every kind of colour vision, readable in grey from dark to light.

const STOPS = {
  // from quiet to loud: for errors, masses, stiffnesses
  rising: ["#4a53c4", "#3d8bcf", "#2db3a5", "#8bd069", "#f5d84a", "#fdf4c4"],
  // from pressed to pulled, the middle is rest
  both: ["#2457a7", "#6fa3dc", "#e9e7e2", "#e79a63", "#b3361e"],
};

const parsed = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));

/** The colour at 0 … 1 of a scale, three numbers 0 … 255. */
export function colour(scale, share) {
  const stops = STOPS[scale];
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const below = Math.min(Math.floor(place), stops.length - 2);
  const [a, b] = [parsed(stops[below]), parsed(stops[below + 1])];
  return a.map((value, i) => value + (b[i] - value) * (place - below));
}

/** The same as CSS writes it. */
export const css = (scale, share) => `rgb(${colour(scale, share).map(Math.round).join(" ")})`;

/** A scale as a CSS gradient to the right. */
export const gradient = (scale) => `linear-gradient(to right, ${STOPS[scale].join(", ")})`;

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
