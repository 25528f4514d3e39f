// Start the live page: connect, build the picture of the scene, show each frame as it comes, send what is asked for.

import { Cloth, edgesOf } from "clothfit/cloth";
import { gradient, repaint } from "clothfit/colours";
import { buildDials } from "clothfit/dials";
import { make } from "clothfit/drawing";
import { Fitting, Keying } from "clothfit/fitting";
import { Hand } from "clothfit/hand";
import { list, listen } from "clothfit/keys";
import { savePicture } from "clothfit/save";
import { MODES, Shading } from "clothfit/shading";
import { Latest, Link } from "clothfit/socket";
import { Stage } from "clothfit/stage";
import { unpacked, unpackedPositions } from "clothfit/unpack";
import { Veil } from "clothfit/veils";
import { viewOf } from "clothfit/view";
import { length, short } from "clothfit/words";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, null];
const ERROR_SHARE = 0.05, STRAIN = 0.1;  // the largest error, by the size of the picture, and strain that colours resolve
const LONG = 2000;  // ms without a frame after which the page says why
const RATE = 1000;  // ms over which frames are counted

const at = (id) => document.getElementById(id);
const page = { scene: null, picture: null, packet: null, target: null, status: null, mode: "plain", drawn: -1 };

function trouble(text) {
  at("trouble").textContent = text ?? "";
  at("trouble").hidden = !text;
}

async function unpackedAll(record) {
  const entries = Object.entries(record).map(async ([name, value]) =>
    [name, value && typeof value === "object" && "data" in value ? await unpacked(value) : value]);
  return Object.fromEntries(await Promise.all(entries));
}

async function unpackedSolid({ points, triangles, tone, paths, ...rest }) {
  const own = paths ? { paths: await unpackedPositions(paths) } : {};
  return { ...(await unpackedAll({ points, triangles, tone })), ...rest, ...own };
}

/** Positions as the report's cloths take them: a motion whose grid has numbers of its own. */
const motionOf = (positions, frames, vertices) => ({ grid: positions, frames, vertices, low: [0, 0, 0], step: [1, 1, 1] });

function theme() {
  const dark = matchMedia("(prefers-color-scheme: dark)"), root = document.documentElement;
  let chosen = null;
  const apply = () => {
    root.dataset.theme = chosen ?? (dark.matches ? "dark" : "light");
    repaint();
    page.picture?.stage?.skin(root.dataset.theme);
    paint(page.mode);
  };
  dark.addEventListener("change", apply);
  theme.toggle = () => { chosen = root.dataset.theme === "dark" ? "light" : "dark"; apply(); };
  at("theme").addEventListener("click", theme.toggle);
  apply();
}

/** The picture of the scene, in a canvas of its own; what was there before is thrown away, but its view stays. */
function build(keepView) {
  const before = page.picture?.stage, old = at("canvas"), canvas = old.cloneNode(false);
  const view = keepView && before ? [before.orbit.azimuth, before.orbit.height, before.orbit.distance, before.orbit.centre] : null;
  const shown = before ? [before.clothShown, before.over.group.visible, before.threadsShown] : null;
  before?.renderer.dispose();
  before?.renderer.forceContextLoss();
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
    stage = new Stage(canvas, panes, { over: new Veil(target), controls: null }, { ...surroundings, pinned: true, fixed, held }, looked);
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

function paint(mode) {
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
function draw() {
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
  at("clock").replaceChildren(make("b", {}, `${packet.time.toFixed(2)} s`), `  ${packet.number}`);
  const whole = picture.aim ? picture.aim.number * picture.aim.time : scene.frames * scene.delta;
  at("course").style.width = `${Math.min(100, (100 * packet.time) / whole)}%`;
  at("figure-error").textContent = rmse === null ? "–" : length(rmse);
  page.rmse = rmse;
  document.documentElement.dataset.ready = "yes";
  return true;
}

function run() {
  const times = [];
  let last = performance.now();
  const tick = (now) => {
    if (draw()) {
      times.push(now);
      last = now;
    }
    if (!page.status?.running) last = now;
    at("wait").hidden = now - last < LONG;
    if (page.picture?.stage?.stale) page.picture.stage.render();
    while (times.length && times[0] < now - RATE) times.shift();
    at("figure-rate").textContent = times.length || "–";
    page.rate = times.length;
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

function main() {
  const state = { dials: null };
  const link = new Link(`ws://${location.host}/ws${location.search}`, {
    heard: (message) => heard(message),
    shown: (packet) => {
      if (packet.kind === "CFF1") page.packet = packet;
      else {
        page.target = packet;
        if (page.scene?.generation === packet.generation) build(page.picture?.aimed);
      }
    },
    state: (connected) => {
      trouble(connected ? null : "The connection is lost; trying again …");
      document.documentElement.dataset.connected = connected ? "yes" : "no";
    },
  });
  const ask = async (type, fields) => {
    const answer = await link.ask(type, fields);
    if (answer.status) update(answer.status);
    return answer;
  };
  const set = async (fields) => {
    const answer = await ask("set", fields);
    if (answer.type === "refused") at("readout").textContent = answer.reason;
    page.answered = performance.now();
    page.answeredAt = page.packet?.number ?? 0;
    return answer;
  };
  const fitting = new Fitting(ask);
  const keying = new Keying(ask, pose);

  function update(status) {
    page.status = status;
    at("play").classList.toggle("playing", status.running);
    at("play").setAttribute("aria-label", status.running ? "Pause (space)" : "Play (space)");
    at("speed").value = String(status.speed);
    at("loop").checked = status.loop;
    at("undo").disabled = status.undo === 0;
    fitting.update(status);
    keying.update(status);
    trouble(status.error);
  }

  let building = Promise.resolve();
  const heard = (message) => {
    const act = { scene: sceneCame, status: ({ status }) => update(status), values: ({ values }) => state.dials?.update(values),
                  progress: (news) => news.of === "estimate" && fitting.progress(news),
                  ended: (news) => (news.of === "control" ? keying : fitting).ended(news) }[message.type];
    building = building.then(() => act?.(message));
  };

  async function sceneCame(message) {
    const other = page.scene?.generation !== message.generation;
    const [mesh, solids] = await Promise.all([unpackedAll(message.mesh), Promise.all(message.surroundings.solids.map(unpackedSolid))]);
    page.scene = { ...message, mesh, surroundings: { ...message.surroundings, solids } };
    if (other && page.target?.generation !== message.generation) page.target = null;
    build(!other);
    at("title").textContent = message.title;
    document.title = `${message.title} · clothfit live`;
    const springs = mesh.rest.length;
    at("subtitle").textContent = `${message.name} · ${mesh.start.length / 3} vertices · ${springs} springs · steps of ${short(1000 * message.delta)} ms`;
    Object.assign(at("save"), { href: `/scene.json${location.search}`, download: message.name.replace(/(\.[^.]*)?$/, ".json") });
    at("readout").textContent = message.warnings[0] ?? "";
    const objects = mesh.vertex_counts.length;
    state.dials = buildDials({ air: at("air"), factors: at("factors") }, message.values, { objects, airy: message.airy, ask: set });
    page.dials = state.dials.dials;
    if (other) {
      fitting.choose(message.fit, message.airy);
      keying.clear();
      hand.touched.clear();
    }
  }

  /** What is posed: of each object the free vertices that were pulled, or all, and where they are. */
  function pose(which) {
    const { mesh } = page.scene, x = page.packet.positions, found = [];
    let first = 0;
    mesh.vertex_counts.forEach((count, object) => {
      const vertices = [...Array(count).keys()].filter((i) => !mesh.fixed[first + i] && (which === "all" || hand.touched.has(first + i)));
      if (vertices.length) found.push({ object, vertices, positions: vertices.map((i) => [...x.slice(3 * (first + i), 3 * (first + i) + 3)]) });
      first += count;
    });
    return found;
  }

  const puller = new Latest((fields) => link.ask("drag", fields));
  const hand = new Hand(at("stage"), {
    picture: () => page.picture ?? {},
    pulled: (vertex, place) => {
      if (!page.status?.running && !page.status?.error) ask("play");
      puller.offer({ vertex, place });
    },
    released: () => puller.offer({ vertex: null }),
  });
  const toggle = () => ask(page.status?.running ? "pause" : "play");
  const switches = Object.fromEntries([["fitted", "clothShown"], ["target", null], ["mesh", "threadsShown"]].map(([name, flag]) => {
    const act = () => {
      const stage = page.picture?.stage;
      if (!stage) return;
      const owner = flag ? stage : stage.over.group, key = flag ?? "visible";
      owner[key] = !owner[key];
      at(`show-${name}`).setAttribute("aria-pressed", owner[key]);
      stage.stale = true;
    };
    at(`show-${name}`).addEventListener("click", act);
    return [name, act];
  }));
  const grasp = () => {
    hand.on = !hand.on;
    at("use-hand").setAttribute("aria-pressed", hand.on);
  };
  at("use-hand").addEventListener("click", grasp);
  for (const [value, name] of MODES) {
    const input = make("input", { type: "radio", name: "mode", value });
    input.addEventListener("change", () => paint(value));
    at("modes").append(make("label", {}, input, make("span", {}, name)));
  }
  for (const each of SPEEDS) at("speed").append(make("option", { value: String(each) }, each === null ? "fastest" : `${each}×`));
  at("speed").addEventListener("change", () => ask("play", { speed: at("speed").value === "null" ? null : Number(at("speed").value) }));
  at("loop").addEventListener("change", () => ask("play", { loop: at("loop").checked }));
  at("play").addEventListener("click", toggle);
  at("step").addEventListener("click", () => ask("step"));
  at("reset").addEventListener("click", () => ask("reset"));
  at("undo").addEventListener("click", () => ask("undo"));
  at("view").addEventListener("click", () => page.picture?.stage?.fit());
  at("shot").addEventListener("click", () => { page.picture?.stage?.render(); savePicture(at("canvas"), `frame-${page.packet?.number ?? 0}`); });
  at("file").addEventListener("change", async () => {
    const [file] = at("file").files;
    if (!file) return;
    const answer = await ask("load", { scene: await file.text(), name: file.name });
    at("readout").textContent = answer.type === "refused" ? answer.reason : "";
    at("file").value = "";
  });
  const orbit = () => page.picture?.stage?.orbit;
  const act = (keys, shown, does, run) => ({ keys, shown, does, act: run });
  const keys = [
    act([" ", "k"], "space", "play or pause", toggle),
    act(["ArrowRight"], "→", "one step", () => ask("step")),
    act(["Home"], "home", "back to the start", () => ask("reset")),
    act(["u"], "U", "undo", () => ask("undo")),
    act(["h"], "H", "hand: pull the cloth, or only turn the view", grasp),
    act(["+", "="], "+ −", "nearer, farther", () => orbit()?.zoom(0.87)),
    act(["-", "_"], null, null, () => orbit()?.zoom(1.15)),
    act(["Shift ArrowLeft"], "Shift ← → ↑ ↓", "turn the view", () => orbit()?.turn(-0.12, 0)),
    act(["Shift ArrowRight"], null, null, () => orbit()?.turn(0.12, 0)),
    act(["Shift ArrowUp"], null, null, () => orbit()?.turn(0, 0.1)),
    act(["Shift ArrowDown"], null, null, () => orbit()?.turn(0, -0.1)),
    act(["f"], "F", "fit the view", () => page.picture?.stage?.fit()),
    act(["c"], "C T M", "cloth, target, mesh", switches.fitted),
    act(["t"], null, null, switches.target),
    act(["m"], null, null, switches.mesh),
    act(MODES.map((_, i) => String(i + 1)), `1 … ${MODES.length}`, "colours", (key) => paint(MODES[Number(key) - 1][0])),
    act(["d"], "D", "dark or light", () => theme.toggle()),
  ];
  listen(keys);
  list(at("keys"), keys);
  theme();
  paint("plain");
  run();
  window.clothfit = { page, link, hand, fitting, keying };  // for tests, and for users of the developer tools
}

main();
