// Start the live page: connect, build the picture of the scene, show each frame as it comes, send what is asked for.

import { repaint } from "clothfit/colours";
import { buildDials } from "clothfit/dials";
import { make } from "clothfit/drawing";
import { Fitting, Keying } from "clothfit/fitting";
import { Hand } from "clothfit/hand";
import { list, listen } from "clothfit/keys";
import { drawnBySoftware, Pace } from "clothfit/pace";
import { build, draw, page, paint, tell, trouble, unpackedAll, unpackedSolid, weigh } from "clothfit/picture";
import { savePicture } from "clothfit/save";
import { MODES } from "clothfit/shading";
import { Latest, Link } from "clothfit/socket";
import { short } from "clothfit/words";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, null];
const LONG = 2000;  // ms without a frame after which the page says why
const WORDS = 100;  // ms between two changes of the words
const RATE = 1000;  // ms over which frames are counted
const WAITS = {
  load: "the scene is being loaded; if it needs code that this machine has not compiled yet, that takes a minute or two",
  other: "waiting for the engine: its first steps on a machine are compiled, for a minute or two",
};

const at = (id) => document.getElementById(id);

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

function run(pace) {
  const times = [];
  let last = performance.now(), told = 0;
  const show = (id, text) => { if (at(id).textContent !== text) at(id).textContent = text; };
  const tick = (now) => {
    if (draw()) {
      times.push(now);
      last = now;
    }
    const loading = page.status?.busy === "load";
    if (!page.status?.running) last = now;
    at("wait").hidden = now - last < LONG && !loading;
    show("wait-text", WAITS[loading ? "load" : "other"]);
    at("give-up").hidden = !loading;
    const stage = page.picture?.stage;
    if (stage) stage.refine(pace.tick(now, stage.stale));
    if (stage?.stale) stage.render();
    while (times.length && times[0] < now - RATE) times.shift();
    if (now - told > WORDS) {
      told = now;
      if (page.untold) tell();
      show("figure-rate", String(times.length || "–"));
    }
    page.rate = times.length;
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

function main() {
  page.software = drawnBySoftware();
  const state = { dials: null, weighed: true, begun: false, fitted: false };
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
    caption();
  }

  /** One sentence on what is seen. */
  function caption() {
    const values = { estimate: "the best values of the fit so far", control: "the values beside" }[page.status?.busy]
      ?? (state.fitted ? "the fitted values" : "the values beside");
    const goal = page.target ? `, green its target${state.fitted || page.status?.busy ? "" : ", which Fit comes to"}` : "";
    at("seen").textContent = `Blue is the cloth with ${values}${goal}. `;
  }

  let building = Promise.resolve();
  const heard = (message) => {
    const act = { scene: sceneCame, status: ({ status }) => update(status), values: valuesCame,
                  progress: (news) => news.of === "estimate" && fitting.progress(news), ended }[message.type];
    building = building.then(() => act?.(message));
  };

  async function ended(news) {
    if (news.of === "load") {
      at("readout").textContent = news.reason;
      return;
    }
    (news.of === "control" ? keying : fitting).ended(news);
    if (news.of !== "estimate" || typeof news.rmse !== "number") return;
    state.fitted = true;
    await ask("reset");  // and shows the whole motion with what was found
    await ask("play");
  }

  function valuesCame({ values }) {
    state.fitted = false;
    state.dials?.update(values);
    state.weighed = false;
    colour(page.mode);
  }

  /** Colour by what a mode says; masses and stiffnesses that have changed are asked for first. */
  function colour(mode) {
    const weighs = mode === "mass" || mode === "stiffness";
    if (mode !== page.mode) paint(mode);
    if (!weighs || state.weighed) return;
    state.weighed = true;
    weigher.offer(page.scene.generation);
  }

  const weigher = new Latest(async (generation) => {
    const answer = await link.ask("elements");
    if (answer.type === "done" && page.scene.generation === generation) await weigh(answer);
  });

  async function sceneCame(message) {
    const other = page.scene?.generation !== message.generation;
    const [mesh, solids] = await Promise.all([unpackedAll(message.mesh), Promise.all(message.surroundings.solids.map(unpackedSolid))]);
    state.weighed = true;
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
    state.fitted = false;
    caption();
    if (!state.begun && !page.packet?.number) ask("play");
    state.begun = true;
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
    held: () => { if (!page.status?.error) ask("play"); },  // whatever was last heard of playing: it may be late
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
    input.addEventListener("change", () => colour(value));
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
  at("give-up").addEventListener("click", () => ask("cancel"));
  at("file").addEventListener("change", async () => {
    const [file] = at("file").files;
    if (!file) return;
    if (page.status?.busy === "load") await ask("cancel");
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
    act(MODES.map((_, i) => String(i + 1)), `1 … ${MODES.length}`, "colours", (key) => colour(MODES[Number(key) - 1][0])),
    act(["d"], "D", "dark or light", () => theme.toggle()),
  ];
  listen(keys);
  list(at("keys"), keys);
  theme();
  paint("plain");
  run(new Pace(page.software));
  window.clothfit = { page, link, hand, fitting, keying };  // for tests, and for users of the developer tools
}

main();
