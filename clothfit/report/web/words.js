// Numbers as readable text, and how this page calls what it shows.

/** The motions, and the parts of the time: a page may have words of its own for them. */
export const called = { own: "fitted", goal: "target", near: "fitted frames", far: "horizon" };

const LENGTHS = [[1, "m"], [1e-3, "mm"], [1e-6, "µm"], [1e-9, "nm"]];

/** A power as small figures above the line. */
const raised = (power) => String(Number(power)).replace(/./g, (sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[sign]));

/** A number with few digits, with a power of ten only where it is very small or large. */
export function short(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) {
    const [number, power] = value.toExponential(digits - 1).split("e");
    return `${number.includes(".") ? number.replace(/\.?0*$/, "") : number} × 10${raised(power)}`.replace("-", "−");
  }
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}

/** A share in percent; one that is next to nothing is not written out. */
export function percent(share) {
  return share > 0 && share < 1e-5 ? "below 0.001 %" : `${short(100 * share, 2)} %`;
}

/** The unit that suits a length, as [metres, name]. */
export function lengthUnit(metres) {
  return LENGTHS.find(([size]) => metres >= size) ?? LENGTHS[LENGTHS.length - 1];
}

/** A length in the unit that suits it. */
export function length(metres) {
  if (!Number.isFinite(metres)) return "–";
  const [size, name] = lengthUnit(metres);
  return `${short(metres / size)} ${name}`;
}

/** Values that divide low … high into about `count` parts, round in a unit of that size. */
export function ticks(low, high, count = 5, size = 1) {
  if (size !== 1) return ticks(low / size, high / size, count).map((value) => value * size);
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= 0.6 * rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

/** Powers of ten within low … high, no more than about six; round values where there are less than two. */
export function decades(low, high) {
  const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
  const every = Math.max(1, Math.ceil((last - first + 1) / 6));
  const found = [];
  for (let k = first; k <= last; k += every) found.push(10 ** k);
  return found.length > 1 ? found : ticks(low, high, 3).filter((value) => value > 0);
}
