// The viewer of a notebook: one motion, played and turned.

import { Cloth, edgesOf } from "clothfit/cloth";
import { repaint } from "clothfit/colours";
import { Player } from "clothfit/player";
import { Shading } from "clothfit/shading";
import { Stage } from "clothfit/stage";
import { unpacked, unpackedPositions } from "clothfit/unpack";
import { Veil } from "clothfit/veils";
import { viewOf } from "clothfit/view";

const at = (id) => document.getElementById(id);

async function unpackedAll(record) {
  const entries = Object.entries(record).map(async ([name, value]) =>
    [name, value && typeof value === "object" && "data" in value ? await unpacked(value) : value]);
  return Object.fromEntries(await Promise.all(entries));
}

async function unpackedSolid({ points, triangles, tone, paths, ...rest }) {
  const own = paths ? { paths: await unpackedPositions(paths) } : {};
  return { ...(await unpackedAll({ points, triangles, tone })), ...rest, ...own };
}

async function main() {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  repaint();
  const content = JSON.parse(at("content").textContent);
  const [mesh, motion, solids] = await Promise.all([unpackedAll(content.mesh), unpackedPositions(content.motion),
                                                    Promise.all(content.surroundings.solids.map(unpackedSolid))]);
  const edges = edgesOf(mesh.triangles, mesh.springs, motion.vertices);
  const cloth = new Cloth(motion, mesh.triangles, edges), target = new Cloth(motion, mesh.triangles, edges);
  const around = { ...content.surroundings, solids }, view = viewOf([motion], cloth, around, edges);
  const errors = { grades: new Uint8Array(motion.vertices), most: 1 };
  const panes = [{ name: "motion", cloth, on: true, shading: new Shading(cloth, { ...mesh, errors, observed: null }, 2 * view.radius) }];
  const veil = new Veil(target);
  const held = [...mesh.fixed.keys()].filter((i) => mesh.fixed[i]);
  const fixed = held.flatMap((i) => [...mesh.start.slice(3 * i, 3 * i + 3)]);
  const stage = new Stage(at("canvas"), panes, { over: veil, controls: null }, { ...around, fixed, held }, view);
  stage.skin(document.documentElement.dataset.theme);
  veil.group.visible = mesh.triangles.length === 0 && edges.length === 0;  // points alone
  const show = (frame, share) => {
    cloth.move(frame, share);
    target.move(frame, share);
    stage.move(frame, share);
    stage.stale = true;
  };
  const player = new Player(content.times, show, (frame) => {
    at("scrub").value = frame;
    at("clock").textContent = `${content.times[frame].toFixed(2)} s`;
  });
  at("label").textContent = content.label;
  at("bar").hidden = content.times.length < 2;
  at("scrub").max = content.times.length - 1;
  at("scrub").addEventListener("input", () => { player.pause(); player.goToFrame(Number(at("scrub").value)); });
  player.changed = () => { at("play").textContent = player.playing ? "❚❚" : "▶"; };
  at("play").addEventListener("click", () => player.toggle());
  at("mesh").addEventListener("click", () => {
    stage.threadsShown = !stage.threadsShown;
    at("mesh").setAttribute("aria-pressed", stage.threadsShown);
    stage.stale = true;
  });
  stage.resized = () => { player.frame = -1; player.goTo(player.time); };
  player.goTo(content.times[0]);
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();
  let before = performance.now();
  const tick = (now) => {
    player.pass(Math.min((now - before) / 1000, 0.25));
    before = now;
    if (stage.stale) stage.render();
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
  document.documentElement.dataset.ready = "yes";
}

main();
