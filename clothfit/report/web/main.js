// Start the page: unpack its content, build the picture and the charts, and let time pass.

import { Arrows } from "clothfit/arrows";
import { Cloth, edgesOf } from "clothfit/cloth";
import { gradient, repaint } from "clothfit/colours";
import { fillControlSide, markTrack } from "clothfit/control_side";
import { make } from "clothfit/drawing";
import { Ghosts } from "clothfit/ghosts";
import { list, listen } from "clothfit/keys";
import { listenToPanes, namePanes, panesOf } from "clothfit/panes";
import { Player, SPEEDS } from "clothfit/player";
import { savePicture } from "clothfit/save";
import { MODES, Shading } from "clothfit/shading";
import { fillHeadline, fillSide } from "clothfit/side";
import { LEVELS, Stage } from "clothfit/stage";
import { Veil } from "clothfit/veils";
import { unpacked, unpackedErrors, unpackedFlags, unpackedPositions } from "clothfit/unpack";
import { viewOf } from "clothfit/view";
import { called, length, percent, short } from "clothfit/words";

const SLOW = 45, PATIENCE = 700;  // ms: frames slower than the first for longer than the second make a playing picture coarser

const ASIDE = 0.7;  // rad: forces often stand upright on a cloth

const at = (id) => document.getElementById(id);
const trouble = (text) => { at("trouble").textContent = text; at("trouble").hidden = false; };

async function unpackedAll(record) {
  const entries = Object.entries(record).map(async ([name, value]) =>
    [name, value && typeof value === "object" && "data" in value ? await unpacked(value) : value]);
  return Object.fromEntries(await Promise.all(entries));
}

/** The motion of another scene, and its colours' values. */
async function unpackedBeside(record) {
  const [values, fitted, error] = await Promise.all([
    unpackedAll({ rest: record.rest, mass: record.mass, stiffness: record.stiffness }),
    unpackedPositions(record.fitted), unpackedErrors(record.error),
  ]);
  return { ...values, name: record.name, fitted, error };
}

async function unpackedSolid({ points, triangles, tone, paths, ...rest }) {
  const own = paths ? { paths: await unpackedPositions(paths) } : {};
  return { ...(await unpackedAll({ points, triangles, tone })), ...rest, ...own };
}

/** What is drawn of keys and forces; null where the page shows no controlled motion. */
async function unpackedControl(record) {
  if (!record) return null;
  const [poses, forces, asked] = await Promise.all([
    unpackedPositions(record.poses), unpackedPositions(record.forces), unpackedFlags(record.asked),
  ]);
  return { ...record, poses, forces, asked };
}

const sums = (counts) => counts.reduce((found, count) => [...found, found[found.length - 1] + count], [0]);

function theme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const root = document.documentElement;
  let chosen = null;
  const apply = () => { root.dataset.theme = chosen ?? (dark.matches ? "dark" : "light"); theme.changed?.(root.dataset.theme); };
  dark.addEventListener("change", apply);
  theme.toggle = () => { chosen = root.dataset.theme === "dark" ? "light" : "dark"; apply(); };
  at("theme").addEventListener("click", theme.toggle);
  apply();
}

/** The picture with the cloths in it; its stage is null where the browser cannot draw. */
function build(content, mesh, parts, canvas) {
  const edges = edgesOf(mesh.triangles, mesh.springs, parts.fitted.vertices);
  const fitted = new Cloth(parts.fitted, mesh.triangles, edges);
  const { control } = content;
  const target = control ? null : new Cloth(parts.target, mesh.triangles, edges, parts.observed);
  const others = parts.beside.map((each) => new Cloth(each.fitted, mesh.triangles, edges));
  const view = viewOf([parts.fitted, control?.poses ?? parts.target], fitted, content.surroundings, edges, control ? ASIDE : 0);
  const held = [...mesh.fixed.keys()].filter((i) => mesh.fixed[i]);
  const fixed = held.flatMap((i) => [...mesh.start.slice(3 * i, 3 * i + 3)]);
  const { observed } = parts;
  const motions = [fitted, ...others].map((cloth, k) => {
    const own = k === 0 ? { errors: parts.errors } : { ...parts.beside[k - 1], errors: parts.beside[k - 1].error };
    return { name: k > 0 ? parts.beside[k - 1].name : control ? "controlled" : called.own, cloth,
             shading: new Shading(cloth, { ...mesh, ...own, observed, goal: control && "next key" }, 2 * view.radius) };
  });
  Shading.agree(motions.map(({ shading }) => shading));
  const panes = panesOf(motions, at("chips"), canvas.clientWidth);
  const shading = panes[0].shading;
  const over = control ? new Ghosts(control, mesh.triangles, edges, 2.2 * view.pin) : new Veil(target);
  const controls = control && new Arrows(control, fitted, view.radius);
  try {
    return { fitted, target, over, controls, panes, shading, stage: new Stage(canvas, panes, { over, controls }, { ...content.surroundings, fixed, held }, view) };
  } catch (error) {
    trouble("This browser cannot draw in 3-D here (WebGL is off); charts and numbers are shown.");
    return { fitted, target, over, controls, panes, shading, stage: null };
  }
}

function showLegend(legend) {
  const box = at("legend");
  box.hidden = legend === null;
  if (!legend) return;
  box.replaceChildren(
    make("span", {}, legend.title), make("span", { class: "bar", style: `background: ${gradient(legend.scale)}` }),
    make("span", { class: "labels" }, ...legend.labels.map((text) => make("span", {}, text))),
  );
}

function chooseMode(mode, { shading, stage }, player) {
  at("modes").querySelector(`[value=${mode}]`).checked = true;
  stage?.paint(mode);
  showLegend(shading.legend);
  player.goTo(player.time);
}

function buildModes(chosen) {
  for (const [value, name] of MODES) {
    const input = make("input", { type: "radio", name: "mode", value });
    input.addEventListener("change", () => chosen(value));
    at("modes").append(make("label", {}, input, make("span", {}, name)));
  }
}

function toggles({ stage }) {
  const parts = { fitted: [stage, "clothShown"], target: [stage?.over.group, "visible"], mesh: [stage, "threadsShown"],
                  controls: [stage, "controlsShown"] };
  const switches = {};
  for (const [name, [owner, flag]] of Object.entries(parts)) {
    const button = at(`show-${name}`);
    switches[name] = () => {
      if (!stage) return;
      owner[flag] = !owner[flag];
      button.setAttribute("aria-pressed", owner[flag]);
      stage.stale = true;
    };
    if (stage) button.setAttribute("aria-pressed", owner[flag]);
    button.addEventListener("click", switches[name]);
  }
  return switches;
}

function controls(player) {
  const scrub = at("scrub"), speed = at("speed"), play = at("play");
  scrub.max = player.times.length - 1;
  scrub.addEventListener("input", () => { player.pause(); player.goToFrame(Number(scrub.value)); });
  play.addEventListener("click", () => player.toggle());
  for (const each of SPEEDS) speed.append(make("option", { value: each }, `${each}×`));
  speed.addEventListener("change", () => { player.speed = Number(speed.value); });
  player.changed = () => {
    play.classList.toggle("playing", player.playing);
    play.setAttribute("aria-label", player.playing ? "Pause (space)" : "Play (space)");
    speed.value = player.speed;
  };
  player.changed();
}

/** Go to the key after the present frame, or to the one before. */
function toKey(player, due, on) {
  const found = on ? due.find((frame) => frame > player.frame) : due.findLast((frame) => frame < player.frame);
  player.pause();
  if (found !== undefined) player.goToFrame(found);
}

/** The page of a controlled motion says so. */
function nameControl(control, player) {
  at("show-fitted").textContent = "cloth";
  at("show-target").textContent = "keys";
  at("show-target").title = "Keys (T)";
  at("show-fitted").title = "Cloth (C)";
  const pushes = control.largest > 0;
  at("show-controls").hidden = !(pushes || control.handles.length);
  if (!pushes) at("show-controls").textContent = "handles";
  at("canvas").setAttribute("aria-label", "The controlled cloth, its keys and the forces in 3-D. Drag to turn, wheel to zoom; keys are listed below.");
  markTrack(at("track"), control, player.times.length - 1, (k) => { player.pause(); player.goToFrame(control.due[k]); });
}

/** The buttons of both motions bear their names. */
function nameMotions() {
  for (const [id, name, letter] of [["show-fitted", called.own, "C"], ["show-target", called.goal, "T"]]) {
    at(id).textContent = name;
    at(id).title = `${name[0].toUpperCase()}${name.slice(1)} (${letter})`;
  }
}

/** What is written in the corner of the picture of a controlled motion. */
function controlReadout(control, frame, time, rmse, force) {
  const k = Math.max(control.due.findIndex((due) => due >= frame), -1), next = k < 0 ? control.due.length - 1 : k;
  const when = control.due[next] === frame ? "key" : k < 0 ? `${short(time - control.times[next])} s after the last key` :
    `next key in ${short(control.times[next] - time)} s`;
  return [`${when} · distance `, make("b", {}, length(rmse)), control.largest > 0 ? ` · forces up to ${short(force)} N` : ""];
}

function actions(player, stage, switches, choose, due) {
  const act = (keys, shown, does, act) => ({ keys, shown, does, act });
  return [
    act([" ", "k"], "space", "play or pause", () => player.toggle()),
    act(["ArrowLeft", "ArrowRight"], "← →", "a frame back, on", (key) => player.step(key === "ArrowLeft" ? -1 : 1)),
    act(["PageUp", "PageDown"], "page up, down", "ten frames", (key) => player.step(key === "PageUp" ? -10 : 10)),
    act(["Home"], "home", "first frame", () => { player.pause(); player.goToFrame(0); }),
    act(["End"], "end", "last frame", () => { player.pause(); player.goToFrame(Infinity); }),
    act(["[", ","], "[ ]", "slower, faster", () => player.faster(-1)),
    act(["]", "."], null, null, () => player.faster(1)),
    act(["+", "="], "+ −", "nearer, farther", () => stage?.orbit.zoom(0.87)),
    act(["-", "_"], null, null, () => stage?.orbit.zoom(1.15)),
    act(["Shift ArrowLeft"], "Shift ← → ↑ ↓", "turn the view", () => stage?.orbit.turn(-0.12, 0)),
    act(["Shift ArrowRight"], null, null, () => stage?.orbit.turn(0.12, 0)),
    act(["Shift ArrowUp"], null, null, () => stage?.orbit.turn(0, 0.1)),
    act(["Shift ArrowDown"], null, null, () => stage?.orbit.turn(0, -0.1)),
    act(["f"], "F", "fit the view", () => stage?.fit()),
    act(["c"], "C T M", due ? "cloth, keys, mesh" : `${called.own} cloth, ${called.goal}, mesh`, switches.fitted),
    act(["t"], null, null, switches.target),
    act(["m"], null, null, switches.mesh),
    act(MODES.map((_, i) => String(i + 1)), `1 … ${MODES.length}`, "colours", (key) => choose(MODES[Number(key) - 1][0])),
    ...(due ? [act(["a"], "A", "forces", switches.controls),
               act(["n", "p"], "N P", "next key, previous key", (key) => toKey(player, due, key === "n"))] : []),
    act(["d"], "D", "dark or light", () => theme.toggle()),
  ];
}

/** Let time pass and draw what has changed, more coarsely while a slow machine plays. */
function run(player, stage) {
  let before = performance.now(), level = 0, slow = 0;
  const tick = (now) => {
    const passed = now - before;
    before = now;
    player.pass(Math.min(passed / 1000, 0.25));
    slow = player.playing && passed > SLOW ? slow + Math.min(passed, 250) : 0;
    if (slow > PATIENCE) [level, slow] = [Math.min(level + (passed > 3 * SLOW ? 3 : 1), LEVELS.length - 1), 0];
    stage?.refine(player.playing ? level : 0);
    if (stage?.stale) stage.render();
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

async function main() {
  theme();
  repaint();
  const content = JSON.parse(at("content").textContent);
  at("content").remove();  // its text is not needed twice
  if (typeof DecompressionStream === "undefined") {
    throw new Error("the browser is too old to unpack the motion; one of 2023 or later can");
  }
  const { motion } = content;
  Object.assign(called, content.words);
  const [mesh, fittedMotion, targetMotion, observed, errors, blocks, beside, residuals] = await Promise.all([
    unpackedAll(content.mesh), unpackedPositions(motion.fitted), motion.target ? unpackedPositions(motion.target) : null,
    unpackedFlags(motion.observed), unpackedErrors(motion.error), Promise.all(content.blocks.map(unpackedAll)),
    Promise.all(content.beside.map(unpackedBeside)), unpackedAll(content.residuals ?? {}),
  ]);
  content.residuals = residuals;
  const control = content.control = await unpackedControl(content.control);
  content.surroundings.solids = await Promise.all(content.surroundings.solids.map(unpackedSolid));
  Object.assign(mesh, { firsts: sums(mesh.vertex_counts), springFirsts: sums(mesh.spring_counts) });
  const picture = build(content, mesh, { fitted: fittedMotion, target: targetMotion, observed, errors, beside },
                        at("canvas"));
  const { target, panes, stage } = picture;
  fillHeadline(at("verdict"), content.headline);
  at("subtitle").textContent = control ? `${content.names.scene}, led through ${control.due.length === 1 ? "a keyframe" : `${control.due.length} keyframes`}` :
    `${content.names.fitted} beside ${content.names.target ?? `the motion of ${content.names.scene}`}`;
  at("headline").append(...content.figures.map(([name, value]) => make("div", {}, make("b", {}, value), make("span", {}, name))));
  let moveCursor = () => ({});
  const show = (frame, share) => {
    (target ?? picture.over).move(frame, share);
    for (const { on, cloth, shading } of panes) {
      if (!on) continue;
      cloth.move(frame, share);
      shading.paint(frame);
    }
    picture.controls?.move(frame);
    moveCursor(player.time);
    stage?.move(frame, share);
    if (stage) stage.stale = true;
  };
  const describe = (frame) => {
    at("scrub").value = frame;
    at("scrub").setAttribute("aria-valuetext", `frame ${frame}, ${short(motion.times[frame])} seconds`);
    at("clock").replaceChildren(make("b", {}, `${motion.times[frame].toFixed(2)} s`), `  ${frame} / ${motion.times.length - 1}`);
    const { rmse, largest, others, force } = moveCursor(player.time);
    if (stage) namePanes(at("panes"), panes, stage.cells, [rmse, ...others]);
    if (control) {
      at("readout").replaceChildren(...controlReadout(control, frame, motion.times[frame], rmse, force));
      return;
    }
    const phase = motion.times[frame] <= content.curve.fitted_until * (1 + 1e-9) ? called.near : called.far;
    const seen = typeof rmse === "number";
    const { travel } = content.residuals;
    const part = seen && travel > 0 ? `, ${percent(rmse / travel)} of the travel` : "";
    const error = seen ? ["RMSE ", make("b", {}, length(rmse)), `${part} · largest ${length(largest)}`] : [`${called.goal} not observed`];
    at("readout").replaceChildren(phase && `${phase} · `, ...error);
  };
  const player = new Player(motion.times, show, describe);
  const jump = (time) => { player.pause(); player.goTo(time); };
  moveCursor = control ? fillControlSide(at("side"), content, jump) : fillSide(at("side"), content, mesh, blocks, jump);
  const choose = (mode) => chooseMode(mode, picture, player);
  buildModes(choose);
  controls(player);
  if (control) nameControl(control, player);
  else if (content.words) nameMotions();
  const keys = actions(player, stage, toggles(picture), choose, control?.due);
  listen(keys);
  list(at("keys"), keys);
  at("fit").addEventListener("click", () => stage?.fit());
  at("shot").addEventListener("click", () => { stage?.render(); savePicture(at("canvas"), `frame-${player.frame}`); });
  const again = () => { player.frame = -1; player.goTo(player.time); };
  listenToPanes(panes, () => { stage?.resize(); again(); });
  if (stage) {
    theme.changed = (name) => {
      repaint();
      stage.skin(name);
      choose(at("modes").querySelector(":checked").value);
    };
    stage.skin(document.documentElement.dataset.theme);
    stage.resized = again;
  } else theme.changed = repaint;
  choose("plain");
  player.goTo(motion.times[0]);
  run(player, stage);
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();
  window.clothfit = { player, stage, ...picture };  // for tests, and for users of the developer tools
  document.documentElement.dataset.ready = "yes";
}

main().catch((error) => {
  document.documentElement.dataset.ready = "no";
  trouble(`This page could not be shown: ${error.message}`);
  throw error;
});
