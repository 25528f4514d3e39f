// The cards of the fit and of the keyframes: what to fit, the course of the cost, keys and the forces that reach them.

import { descentChart } from "clothfit/charts";
import { make } from "clothfit/drawing";
import { length, short } from "clothfit/words";

const MODES = [["n", "keep"], ["F", "one factor"], ["R", "each part"], ["M", "smooth map"], ["L", "each single"]];
const FLAGS = [["damping", "damping"], ["drag", "air drag"], ["wind", "wind"], ["gravity", "gravity"]];
const MOST_POINTS = 400;
const ENDS = { converged: "converged", stalled: "stalled before its tolerance", limit: "ended at its limit",
               interrupted: "cancelled; the best is kept", cancelled: "cancelled", failed: "failed" };

const TITLES = { xTitle: "time, s", yTitle: "RMSE, mm", label: "The best RMSE to the target over the seconds of the fit" };

const at = (id) => document.getElementById(id);

export class Fitting {
  constructor(ask, say) {
    Object.assign(this, { ask, say, history: [], busy: null });
    this.selects = {};
    for (const kind of ["stiffness", "mass"]) {
      const select = make("select", { id: `fit-${kind}` }, ...MODES.map(([value, text]) => make("option", { value }, text)));
      this.selects[kind] = select;
      at("choices").append(make("label", { class: "wide-choice" }, make("span", {}, kind === "mass" ? "masses" : "stiffnesses"), select));
    }
    this.checks = Object.fromEntries(FLAGS.map(([name, text]) => {
      const box = make("input", { type: "checkbox", id: `fit-${name}` });
      at("choices").append(make("label", {}, box, text));
      return [name, box];
    }));
    at("fit").addEventListener("click", () => this.press());
  }

  /** Choose what the file of the scene asks to fit. */
  choose(asked, airy) {
    for (const [kind, select] of Object.entries(this.selects)) select.value = asked[kind] === "G" ? "F" : asked[kind];
    for (const [name, box] of Object.entries(this.checks)) {
      box.checked = asked[name];
      box.parentElement.hidden = !airy && (name === "drag" || name === "wind");
    }
    if (!Object.values(asked).some((each) => each === true || (each && each !== "n"))) this.selects.stiffness.value = "F";
    this.clear();
  }

  clear() {
    this.history = [];
    at("cost").replaceChildren();
  }

  async press() {
    if (this.busy) {
      await this.tried("cancel");
      return;
    }
    const fit = Object.fromEntries([...Object.entries(this.selects).map(([kind, each]) => [kind, each.value]),
                                    ...Object.entries(this.checks).map(([name, box]) => [name, box.checked])]);
    this.clear();
    at("fit-text").textContent = "starting …";
    await this.tried("estimate", { fit });
  }

  async tried(type, fields) {
    const answer = await this.ask(type, fields);
    if (answer.type === "refused") at("fit-text").textContent = answer.reason;
  }

  /** Take the status: whether there is a target, and what is computed. */
  update({ busy, target }) {
    this.busy = busy === "estimate" ? busy : null;
    const button = at("fit");
    button.textContent = this.busy ? "Cancel" : "Fit";
    button.disabled = !target || (busy !== null && busy !== "estimate");
    at("fit-note").textContent = target ? "" : "the target is being computed …";
  }

  progress({ rmse, seconds, evaluations, stage }) {
    if (rmse > 0) {
      this.history.push([seconds, 1000 * rmse]);
      if (this.history.length > MOST_POINTS) this.history = this.history.filter((_, i) => i % 2 === 0 || i > MOST_POINTS - 20);
    }
    this.draw();
    at("fit-text").textContent = `RMSE ${length(rmse)} · ${evaluations} evaluations · ${stage}`;
  }

  draw() {
    if (this.history.length === 0 || this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (this.history.length) at("cost").replaceChildren(descentChart(this.history, TITLES));
    });
  }

  ended({ status, reason, rmse, evaluations, seconds }) {
    const figures = typeof rmse === "number" ? `: RMSE ${length(rmse)} after ${evaluations} evaluations, ${short(seconds, 2)} s` : "";
    at("fit-text").textContent = reason ?? `${ENDS[status] ?? status}${figures}`;
  }
}

export class Keying {
  /** `pose()` gives {vertices: [[…] of each object], positions} of what was pulled, or of all. */
  constructor(ask, pose) {
    Object.assign(this, { ask, pose, keys: [], busy: false });
    at("key-add").addEventListener("click", () => this.add());
    at("control").addEventListener("click", () => this.press());
  }

  add() {
    const time = Number(at("key-time").value), own = this.pose(at("key-of").value);
    if (!(time > 0)) return this.say("a key needs a time after the start");
    if (own.length === 0) return this.say("pull the cloth first, or choose the whole cloth");
    this.keys = [...this.keys.filter((key) => key.time !== time), ...own.map((each) => ({ time, ...each }))];
    this.keys.sort((a, b) => a.time - b.time);
    at("key-time").value = short(time + 1, 4);
    this.list();
  }

  list() {
    const items = this.keys.map((key) => {
      const gone = make("button", { type: "button", "aria-label": `Remove the key at ${key.time} s` }, "✕");
      gone.addEventListener("click", () => { this.keys = this.keys.filter((each) => each !== key); this.list(); });
      const count = key.vertices.length;
      return make("li", {}, `${short(key.time, 4)} s · ${count} ${count === 1 ? "vertex" : "vertices"}`, gone);
    });
    at("key-list").replaceChildren(...items);
    this.enable();
  }

  async press() {
    if (this.busy) {
      await this.ask("cancel");
      return;
    }
    this.say("searching …");
    const answer = await this.ask("control", { keys: this.keys });
    if (answer.type === "refused") this.say(answer.reason);
  }

  update({ busy }) {
    this.busy = busy === "control";
    this.other = busy !== null && busy !== "control" && busy !== "record";
    this.enable();
  }

  enable() {
    at("control").textContent = this.busy ? "Cancel" : "Find forces";
    at("control").disabled = !this.busy && (this.keys.length === 0 || this.other === true);
  }

  ended({ status, reason, keys }) {
    const missed = keys?.length ? `; the keys are missed by ${length(Math.max(...keys.map((key) => key.rmse ?? 0)))} at most` : "";
    this.say(reason ?? `${ENDS[status] ?? status}${missed}`);
  }

  clear() {
    this.keys = [];
    this.list();
  }

  say(text) {
    at("control-text").textContent = text;
  }
}
