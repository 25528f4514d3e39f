// What the cloth's colours can show: distance to the target, mass, stiffness, strain; each with its legend.
//
// A quantity of springs is shown at each vertex as the mean over the springs there.

import { BufferAttribute, DynamicDrawUsage } from "three";
import { painted, table } from "clothfit/colours";
import { called, lengthUnit, short } from "clothfit/words";

export const MODES = [
  ["plain", "Plain"], ["error", "Error"], ["mass", "Mass"], ["stiffness", "Stiffness"], ["strain", "Strain"],
];

const INVISIBLE = 1e-4;  // of the picture's size: smaller errors are invisible, so the colours do not resolve them
const WIDE = 30;  // values that differ by more than this factor have a logarithmic scale
const UNKNOWN = 0.18;  // a grey, in linear light
const TABLES = {};
painted(() => Object.assign(TABLES, { rising: table("rising"), both: table("both") }));

export class Shading {
  /** `data`: springs, rest, mass, stiffness, errors {grades, most}, observed or null; `size` of the picture, m. */
  constructor(cloth, data, size) {
    Object.assign(this, { cloth, data, mode: "plain" });
    this.count = cloth.motion.vertices;
    this.attribute = new BufferAttribute(new Float32Array(3 * this.count), 3);
    this.attribute.setUsage(DynamicDrawUsage);
    this.most = Math.max(percentile(data.errors), INVISIBLE * size);
    this.degree = new Float32Array(this.count);
    for (const vertex of data.springs) this.degree[vertex]++;
    this.strain = new Float32Array(this.count);
    this.stretch = this.largestStrain();
    this.weigh(data);
  }

  /** Take the masses and stiffnesses to colour by. */
  weigh({ mass, stiffness }) {
    this.still = { mass: scaleOf(mass, "kg"), stiffness: scaleOf(this.meanOfSprings(stiffness), "N/m") };
  }

  /** Let the colours of several cloths mean the same. */
  static agree(all) {
    const most = (name) => Math.max(...all.map((each) => each[name]));
    const [error, stretch] = [most("most"), most("stretch")];
    for (const kind of ["mass", "stiffness"]) {
      const scale = scaleOf(all.flatMap((each) => [each.still[kind].low, each.still[kind].high]), all[0].still[kind].unit);
      for (const each of all) each.still[kind] = { ...scale, values: each.still[kind].values };
    }
    for (const each of all) Object.assign(each, { most: error, stretch });
  }

  /** Choose what the colours show; returns the colour attribute, or null for none. */
  choose(mode) {
    this.mode = mode;
    if (mode in this.still) this.paintScale(this.still[mode]);
    return mode === "plain" ? null : this.attribute;
  }

  /** Colour a frame, where the colours change from frame to frame. */
  paint(frame) {
    if (this.mode === "error") this.paintErrors(frame);
    if (this.mode === "strain") this.paintStrain();
  }

  paintErrors(frame) {
    const { errors: { grades, most }, observed } = this.data;
    const first = frame * this.count;
    this.fill("rising", (i) => (most * (grades[first + i] / 255) ** 2) / this.most);
    for (let i = 0; observed && i < this.count; i++) {
      if (!observed[first + i]) this.attribute.array.fill(UNKNOWN, 3 * i, 3 * i + 3);
    }
  }

  paintStrain() {
    this.measureStrain();
    this.fill("both", (i) => 0.5 + (0.5 * this.strain[i]) / this.stretch);
  }

  paintScale({ values, share }) {
    this.fill("rising", (i) => share(values[i]));
  }

  fill(scale, share) {
    const colours = this.attribute.array, entries = TABLES[scale];
    for (let i = 0; i < this.count; i++) {
      const at = 3 * Math.round(255 * Math.min(Math.max(share(i), 0), 1));
      colours[3 * i] = entries[at];
      colours[3 * i + 1] = entries[at + 1];
      colours[3 * i + 2] = entries[at + 2];
    }
    this.attribute.needsUpdate = true;
  }

  /** Mean of L / L0 − 1 of the springs at each vertex. */
  measureStrain() {
    const { springs, rest } = this.data, x = this.cloth.positions, { strain, degree } = this;
    strain.fill(0);
    for (let s = 0; s < rest.length; s++) {
      const i = springs[2 * s], j = springs[2 * s + 1], a = 3 * i, b = 3 * j;
      const dx = x[a] - x[b], dy = x[a + 1] - x[b + 1], dz = x[a + 2] - x[b + 2];
      const found = Math.sqrt(dx * dx + dy * dy + dz * dz) / rest[s] - 1;
      strain[i] += found;
      strain[j] += found;
    }
    for (let i = 0; i < strain.length; i++) if (degree[i]) strain[i] /= degree[i];
  }

  /** The strain, of either sign, that all but a hundredth of the vertices stay below at some times; at least 0.1 %. */
  largestStrain() {
    const met = [];
    for (let look = 0; look <= 8; look++) {
      this.cloth.move(Math.round((look / 8) * (this.cloth.motion.frames - 1)), 0);
      this.measureStrain();
      met.push(...Array.from(this.strain, Math.abs).filter((_, i) => i % Math.ceil(this.count / 5000) === 0));
    }
    return Math.max(Float32Array.from(met).sort()[Math.floor(0.99 * (met.length - 1))], 1e-3);
  }

  meanOfSprings(values) {
    const sum = new Float32Array(this.count);
    values.forEach((value, s) => {
      sum[this.data.springs[2 * s]] += value;
      sum[this.data.springs[2 * s + 1]] += value;
    });
    return sum.map((value, i) => (this.degree[i] ? value / this.degree[i] : NaN));
  }

  /** The legend: title, scale of colours, labels from left to right; null for none. */
  get legend() {
    const percent = (share) => `${share > 0 ? "+" : ""}${short(100 * share, 2)} %`;
    switch (this.mode) {
      case "error": {
        const [size, unit] = lengthUnit(this.most);
        return { title: `distance to the ${this.data.goal ?? called.goal}, ${unit}${this.data.observed ? ` (grey: ${this.data.goal ? "not asked for" : "not observed"})` : ""}`, scale: "rising",
                 labels: ["0", short(this.most / size / 2, 2), `${short(this.most / size, 2)} +`] };
      }
      case "strain":
        return { title: "strain: pressed – pulled", scale: "both",
                 labels: [percent(-this.stretch), "0", `${percent(this.stretch)} +`] };
      case "mass":
        return { title: "mass of a vertex, kg", scale: "rising", labels: this.still.mass.labels };
      case "stiffness":
        return { title: "stiffness of the springs at a vertex, N/m", scale: "rising", labels: this.still.stiffness.labels };
      default:
        return null;
    }
  }
}

/** Where values lie between the smallest and the largest, 0 … 1; by logarithms where they differ much. */
export function scaleOf(values, unit) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  if (!(low <= high)) [low, high] = [0, 1];
  const wide = low > 0 && high / low > WIDE;
  const turn = wide ? Math.log : (value) => value;
  const [a, b] = [turn(low), turn(high)];
  const middle = wide ? Math.sqrt(low * high) : (low + high) / 2;
  const equal = high - low <= 1e-6 * Math.abs(high);
  return {
    values, low, high, wide, unit,
    share: (value) => (equal ? 0.5 : (turn(Math.max(value, low)) - a) / (b - a)),
    labels: equal ? ["", short(low), ""] : [low, middle, high].map((value) => short(value)),
  };
}

/** The error that all but a two hundredth of the positions stay below, m. */
function percentile({ grades, most }) {
  const counts = new Uint32Array(256);
  for (const grade of grades) counts[grade]++;
  let left = grades.length * 0.005, grade = 255;
  while (grade > 0 && (left -= counts[grade]) > 0) grade--;
  return most * (grade / 255) ** 2;
}
