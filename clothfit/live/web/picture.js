// What is drawn: the picture of a scene, made anew for each scene, and moved by each frame that comes.

import { Cloth, edgesOf } from "clothfit/cloth";
import { gradient } from "clothfit/colours";
import { make } from "clothfit/drawing";
import { Shading } from "clothfit/shading";
import { Stage } from "clothfit/stage";
import { unpacked, unpackedPositions } from "clothfit/unpack";
import { Veil } from "clothfit/veils";
import { viewOf } from "clothfit/view";
import { length } from "clothfit/words";

const ERROR_SHARE = 0.05, STRAIN = 0.1;  // the largest error, by the size of the picture, and strain that colours resolve

const at = (id) => document.getElementById(id);
export const page = { scene: null, picture: null, packet: null, target: null, status: null, mode: "plain", drawn: -1 };

export function trouble(text) {
  at("trouble").textContent = text ?? "";
  at("trouble").hidden = !text;
}

export async function unpackedAll(record) {
  const entries = Object.entries(record).map(async ([name, value]) =>
    [name, value && typeof value === "object" && "data" in value ? await unpacked(value) : value]);
  return Object.fromEntries(await Promise.all(entries));
}

export async function unpackedSolid({ points, triangles, tone, paths, ...rest }) {
  const own = paths ? { paths: await unpackedPositions(paths) } : {};
  return { ...(await unpackedAll({ points, triangles, tone })), ...rest, ...own };
}

/** Positions as the report's cloths take them: a motion whose grid has numbers of its own. */
const motionOf = (positions, frames, vertices) => ({ grid: positions, frames, vertices, low: [0, 0, 0], step: [1, 1, 1] });

/** The picture of the scene, in a canvas of its own; what was there before is thrown away, but its view stays. */
export function build(keepView) {
  const before = page.picture?.stage, old = at("canvas"), canvas = old.cloneNode(false);
  const view = keepView && before ? [before.orbit.azimuth, before.orbit.height, before.orbit.distance, before.orbit.centre] : null;
  const shown = before ? [before.clothShown, before.over.group.visible, before.threadsShown] : null;
  before?.dispose();
  old.replaceWith(canvas);
  const { mesh, surroundings } = page.scene, vertices = mesh.start.length / 3;
  const edges = edgesOf(mesh.triangles, mesh.springs, vertices);
  const live = new Cloth(motionOf(Float32Array.from(mesh.start), 1, vertices), mesh.triangles, edges);
  const aim = page.target?.generation === page.scene.generation ? page.target : null;
  const frames = aim ? aim.number : 1, seen = aim ? flags(aim.positions) : null;
  const goal = motionOf(aim ? filled(aim.positions, mesh.start) : mesh.start, frames, vertices);
  const target = new Cloth(goal, mesh.triangles, edges, seen);
  const looked = viewOf([live.motion, goal], target, surroundings, edges);
  const errors = { grades: new Uint8Array(vertices), most: 2 * looked.radius * ERROR_SHARE };
  const shading = new Shading(live, { ...mesh, errors, observed: null }, 2 * looked.radius);
  Object.assign(shading, { most: errors.most, stretch: STRAIN });
  const held = [...mesh.fixed.keys()].filter((i) => mesh.fixed[i]);
  const fixed = held.flatMap((i) => [...mesh.start.slice(3 * i, 3 * i + 3)]);
  const panes = [{ name: "live", cloth: live, shading, on: true }];
  let stage = null;
  try {
    stage = new Stage(canvas, panes, { over: new Veil(target), controls: null }, { ...surroundings, pinned: true, fixed, held }, looked,
      !page.software);
    stage.skin(document.documentElement.dataset.theme);
    stage.over.group.visible = aim !== null;
    if (shown) [stage.clothShown, stage.threadsShown] = [shown[0], shown[2]];
    if (shown && aim && page.picture.aimed) stage.over.group.visible = shown[1];
    if (view) {
      const [azimuth, height, distance, centre] = view;
      Object.assign(stage.orbit, { azimuth, height, distance });
      stage.orbit.centre.copy(centre);
      stage.orbit.place();
      stage.fittedOnce = true;
    }
  } catch {
    trouble("This browser cannot draw in 3-D here (WebGL is off); numbers are shown.");
  }
  page.picture = { live, target, aim, shading, stage, errors, aimed: aim !== null };
  for (const [name, on] of [["fitted", stage?.clothShown], ["target", stage?.over.group.visible], ["mesh", stage?.threadsShown]]) {
    at(`show-${name}`).setAttribute("aria-pressed", Boolean(on));
  }
  at("show-target").hidden = aim === null;
  page.drawn = -1;
  paint(page.mode);
}

/** Which positions of a target were observed; null where all were. */
function flags(positions) {
  if (!positions.some(Number.isNaN)) return null;
  return Uint8Array.from({ length: positions.length / 3 }, (_, i) => (Number.isNaN(positions[3 * i]) ? 0 : 1));
}

/** A target whose gaps hold the position before. */
function filled(positions, start) {
  const found = Float32Array.from(positions), row = start.length;
  for (let i = 0; i < found.length; i++) if (Number.isNaN(found[i])) found[i] = i < row ? start[i] : found[i - row];
  return found;
}

export function paint(mode) {
  page.mode = mode;
  const input = at("modes").querySelector(`[value=${mode}]`);
  if (input) input.checked = true;
  if (!page.picture) return;
  const { stage, shading } = page.picture;
  stage?.paint(mode);
  const legend = shading.legend;
  at("legend").hidden = legend === null;
  if (legend) {
    at("legend").replaceChildren(
      make("span", {}, legend.title), make("span", { class: "bar", style: `background: ${gradient(legend.scale)}` }),
      make("span", { class: "labels" }, ...legend.labels.map((text) => make("span", {}, text))));
  }
  page.drawn = -1;
}

/** The frame of the target at a time: the nearest one at or after it; null after its end. */
function aimAt(time) {
  const { aim } = page.picture;
  if (!aim) return null;
  const frame = Math.round(time / aim.time);
  return frame < aim.number ? frame : null;
}

/** The distances to the target at its frame; returns their root mean square, or null. */
function compare(frame) {
  const { aim, errors, live } = page.picture, x = live.motion.grid;
  if (frame === null) {
    errors.grades.fill(0);
    return null;
  }
  const first = frame * x.length, goal = aim.positions;
  let sum = 0, count = 0;
  for (let i = 0; i < x.length; i += 3) {
    const away = (x[i] - goal[first + i]) ** 2 + (x[i + 1] - goal[first + i + 1]) ** 2 + (x[i + 2] - goal[first + i + 2]) ** 2;
    if (Number.isNaN(away)) continue;
    sum += away;
    count++;
    errors.grades[i / 3] = Math.min(255, Math.round(255 * Math.sqrt(Math.min(Math.sqrt(away) / errors.most, 1))));
  }
  return count ? Math.sqrt(sum / count) : null;
}

/** Show the newest frame, where it is of this scene and was not shown yet. */
export function draw() {
  const { packet, picture, scene } = page;
  if (!picture || !packet || packet.generation !== scene.generation || packet === page.drawn) return false;
  if (packet.positions.length !== picture.live.positions.length) return false;
  page.drawn = packet;
  picture.live.motion.grid.set(packet.positions);
  picture.live.move(0, 0);
  const goal = aimAt(packet.time), rmse = compare(goal);
  picture.target.move(goal ?? (picture.aim ? picture.aim.number - 1 : 0), 0);
  picture.shading.paint(0);
  picture.stage?.move(Math.min(packet.number, scene.frames - 1), 0);
  if (picture.stage) picture.stage.stale = true;
  Object.assign(page, { rmse, untold: true });
  document.documentElement.dataset.ready = "yes";
  return true;
}

/** Say in words what is shown; the browser lays the page out anew for that, so it is not done for each frame. */
export function tell() {
  const { drawn: packet, picture: { aim }, scene, rmse } = page;
  page.untold = false;
  if (!packet.positions) return;
  at("clock").replaceChildren(make("b", {}, `${packet.time.toFixed(2)} s`), `  ${packet.number}`);
  const whole = aim ? aim.number * aim.time : scene.frames * scene.delta;
  at("course").style.width = `${Math.min(100, (100 * packet.time) / whole)}%`;
  at("figure-error").textContent = rmse === null ? "–" : length(rmse);
}

/** Colour by other masses and stiffnesses. */
export async function weigh({ mass, stiffness }) {
  const own = await unpackedAll({ mass, stiffness });
  Object.assign(page.scene.mesh, own);
  page.picture.shading.weigh(own);
  paint(page.mode);
}
