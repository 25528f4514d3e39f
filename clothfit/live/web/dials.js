// Sliders: each shows a value of the scene and changes it while it is moved.

import { make } from "clothfit/drawing";
import { Latest } from "clothfit/socket";
import { short } from "clothfit/words";

const STEPS = 400;
const CURVE = 5;  // how finely a slider from 0 on divides small values

/** Scales: the place of a value on a slider, 0 … 1, and back. */
const linear = (most) => ({ to: (value) => (value / most + 1) / 2, from: (share) => Math.round(most * (2 * share - 1) * 100) / 100 });
const rising = (most) => ({
  to: (value) => Math.log1p((value / most) * Math.expm1(CURVE)) / CURVE,
  from: (share) => Number(((most * Math.expm1(CURVE * share)) / Math.expm1(CURVE)).toPrecision(3)),
});
const factor = { to: (value) => (Math.log10(value) + 1) / 2, from: (share) => Number((10 ** (2 * share - 1)).toPrecision(3)) };

let gestures = 0;

class Dial {
  /** `change(value, gesture)` sends a value, and resolves when it is answered. */
  constructor(name, scale, unit, change) {
    Object.assign(this, { name, scale, unit, first: null });
    this.input = make("input", { type: "range", min: 0, max: STEPS, step: 1, "aria-label": name, "data-own": "" });
    this.output = make("output");
    this.element = make("label", { class: "dial", title: "Double click: back to the first value" }, make("span", {}, name), this.input, this.output);
    this.sender = new Latest(([value, gesture]) => change(value, gesture));
    this.held = false;
    const send = (value) => {
      this.held = true;
      this.say(value);
      this.sender.offer([value, `${name} ${gestures}`]);
    };
    this.input.addEventListener("input", () => send(scale.from(this.input.value / STEPS)));
    this.input.addEventListener("change", () => { gestures++; this.held = false; });
    this.input.addEventListener("dblclick", () => {
      gestures++;
      if (this.first !== null) send(this.first);
      this.show(this.first);
      this.held = false;
    });
  }

  say(value) {
    const text = `${short(value)}${this.unit}`;
    this.output.textContent = text;
    this.input.setAttribute("aria-valuetext", text);
    this.element.classList.toggle("changed", this.first !== null && Math.abs(value - this.first) > 1e-9 * Math.abs(this.first));
  }

  /** Show a value, unless the slider is being moved. */
  show(value) {
    this.first ??= value;
    if (this.held) return;
    this.input.value = Math.round(STEPS * Math.min(Math.max(this.scale.to(value), 0), 1));
    this.say(value);
  }
}

/** The sliders of a scene: `update(values)` shows others. `ask(fields)` sends a `set`. */
export function buildDials(places, values, { objects, airy, ask }) {
  const dials = [];
  let current = values;
  const add = (place, dial, read) => {
    place.append(dial.element);
    dials.push([dial, read]);
  };
  const air = places.air, cloth = places.factors;
  air.replaceChildren();
  cloth.replaceChildren();
  const named = (name, i) => (objects > 1 ? `${name}, ${i}` : name);
  for (let i = 0; i < objects; i++) {
    const of = (name, unit, least) => add(air, new Dial(named(name, i), rising(Math.max(10 * values[name][i], least)), unit,
      (value, gesture) => ask({ object: i, values: { [name]: value }, gesture })), (now) => now[name][i]);
    of("damping", "", 2);
    if (airy) of("drag", "", 2);
  }
  if (airy) {
    const most = Math.max(20, 2 * Math.max(...values.wind.map(Math.abs)));
    ["x", "y", "z"].forEach((axis, c) => add(air, new Dial(`wind ${axis}`, linear(most), " m/s", (value, gesture) => {
      const wind = current.wind.map((each, k) => (k === c ? value : each));
      current = { ...current, wind };
      return ask({ values: { wind }, gesture });
    }), (now) => now.wind[c]));
  }
  for (let i = 0; i < objects; i++) {
    if (objects > 1) cloth.append(make("h3", {}, `objects[${i}]`));
    for (const kind of ["mass", "stiffness"]) {
      const names = Object.keys(values.factors[i][kind]), parts = make("details", {}, make("summary", {}, `${kind} of each part`));
      const dialOf = (place, group, text) => add(place, new Dial(text, factor, " ×",
        (value, gesture) => ask({ object: i, factors: { [kind]: { [group]: value } }, gesture })),
        (now) => now.factors[i][kind][group]);
      dialOf(cloth, "all", kind);
      for (const name of names.filter((each) => each !== "all")) dialOf(parts, name, name);
      if (names.length > 1) cloth.append(parts);
    }
  }
  const update = (now) => {
    current = now;
    dials.forEach(([dial, read]) => dial.show(read(now)));
  };
  update(values);
  return { update, dials: dials.map(([dial]) => dial) };
}
