// The picture: light, ground, spheres, wind, fixed vertices, the two cloths, and a camera that sees all of it.

import {
  Color, ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide, Group, HemisphereLight, InstancedMesh,
  LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, MeshStandardMaterial, PCFShadowMap,
  PerspectiveCamera, PlaneGeometry, Quaternion, Scene, ShaderMaterial, ShadowMaterial, SphereGeometry, Vector3,
  WebGLRenderer,
} from "three";
import { Orbit } from "clothfit/orbit";
import { cells } from "clothfit/panes";
import { placeSolid, solidMesh } from "clothfit/solids";
import { lines } from "clothfit/veils";

const CLOTH = "#7089e0", FIXED = "#f5a524", WIND = "#38bdf8";
const SKINS = {
  light: { grid: "#64748b", gridShare: 0.5, shadow: 0.2, sky: "#ffffff", ground: "#b9bccb", ambient: 1.4, key: 1.75,
           sphere: "#c9ced8" },
  dark: { grid: "#94a3b8", gridShare: 0.38, shadow: 0.45, sky: "#e6ebff", ground: "#5a6180", ambient: 1.5, key: 1.75,
          sphere: "#596173" },
};

/** Levels of detail, for slow machines: resolution along each side, whether shadows, whether the target's edges. */
export const LEVELS = [[1, true, true], [1, false, true], [0.75, false, true], [0.5, false, false]];

const FINE = 1.5;  // resolution of a picture that rests where edges are not smooth

export class Stage {
  /** `panes` are {cloth, shading, on}: the cloths that stand side by side; `over` is drawn over each of them: a veil or
   * ghosts; `controls`, or null, over the first one. Edges are `smooth`, or only when the picture rests. */
  constructor(canvas, panes, { over, controls }, around, view, smooth = true) {
    Object.assign(this, { canvas, panes, fitted: panes[0].cloth, over, controls, view, stale: true, level: 0, ratio: smooth ? 1 : FINE, smooth });
    this.clothShown = this.controlsShown = true;
    this.renderer = new WebGLRenderer({ canvas, antialias: smooth, alpha: true, powerPreference: "high-performance" });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(32, 1, 0.01, 100);
    this.orbit = new Orbit(this.camera, canvas, () => { this.stale = true; });
    this.light();
    this.dress();
    this.floor();
    this.around = around;
    for (const sphere of around.spheres) this.sphere(sphere);
    this.solids = around.solids.map((solid) => solidMesh(solid, view.give));
    for (const solid of this.solids) this.scene.add(solid);
    if (view.arrow) this.wind(view.arrow);
    this.pins(around.fixed);
    this.observer = new ResizeObserver(() => { this.resize(); this.resized?.(); });
    this.observer.observe(canvas.parentElement);
    this.resize();
  }

  light() {
    const { centre, radius } = this.view;
    this.hemisphere = new HemisphereLight();
    this.key = new DirectionalLight("#fff6ea");
    this.rim = new DirectionalLight("#cfdcff", 0.7);
    this.key.position.set(-0.45, 1, 0.6).normalize().multiplyScalar(3 * radius).add(centre);
    this.rim.position.set(0.7, 0.35, -0.8).multiplyScalar(3 * radius).add(centre);
    this.lamp = new DirectionalLight("#ffffff", 0.75);  // moves with the camera, so that no side is black
    for (const each of [this.key, this.rim, this.lamp]) each.target.position.copy(centre);
    this.key.castShadow = true;
    this.key.shadow.mapSize.set(1024, 1024);
    this.key.shadow.radius = 5;
    this.key.shadow.bias = -0.002;
    Object.assign(this.key.shadow.camera, {
      left: -1.3 * radius, right: 1.3 * radius, top: 1.3 * radius, bottom: -1.3 * radius, near: radius, far: 7 * radius,
    });
    this.scene.add(this.hemisphere, this.key, this.rim, this.lamp, this.key.target, this.rim.target, this.lamp.target);
  }

  /** The cloths: those of the panes solid, the other side a little darker; what is drawn over them. */
  dress() {
    this.threadsShown = this.fitted.triangles.length === 0;
    for (const pane of this.panes) this.dressPane(pane);
    this.scene.add(this.over.group);
    if (this.controls) this.scene.add(this.controls.group);
  }

  dressPane(pane) {
    const solid = new MeshLambertMaterial({ color: CLOTH, side: DoubleSide });
    solid.onBeforeCompile = (shader) => {
      shader.fragmentShader = shader.fragmentShader.replace(
        "#include <color_fragment>",
        "#include <color_fragment>\n\tif (!gl_FrontFacing) diffuseColor.rgb *= 0.84;",
      );
    };
    pane.solid = new Mesh(pane.cloth.faces, solid);
    pane.solid.castShadow = true;
    pane.threads = new LineSegments(pane.cloth.lines, lines("#0f172a", 0.3));
    pane.solid.frustumCulled = pane.threads.frustumCulled = false;  // the box of a moving cloth would be out of date
    this.scene.add(pane.solid, pane.threads);
  }

  floor() {
    const { centre, radius, low, cell } = this.view;
    const size = 12 * radius;
    this.grid = new ShaderMaterial({
      transparent: true, depthWrite: false, side: DoubleSide,
      uniforms: {
        tint: { value: new Color() }, cell: { value: cell }, share: { value: 0.4 },
        middle: { value: centre.clone() }, reach: { value: 3.2 * radius },
      },
      vertexShader: `varying vec3 place;
        void main() {
          vec4 p = modelMatrix * vec4(position, 1.0);
          place = p.xyz;
          gl_Position = projectionMatrix * viewMatrix * p;
        }`,
      fragmentShader: `uniform vec3 tint; uniform float cell; uniform float share; uniform vec3 middle; uniform float reach;
        varying vec3 place;
        float line(float size, float width) {
          vec2 at = place.xz / size;
          vec2 fine = fwidth(at);
          vec2 near = abs(fract(at - 0.5) - 0.5) / max(fine, vec2(1e-6));
          return (1.0 - min(min(near.x, near.y) / width, 1.0)) * (1.0 - smoothstep(0.25, 0.6, max(fine.x, fine.y)));
        }
        void main() {
          float away = 1.0 - smoothstep(0.25, 1.0, distance(place.xz, middle.xz) / reach);
          float ink = max(0.45 * line(cell, 1.2), line(5.0 * cell, 1.4));
          gl_FragColor = vec4(tint, ink * away * share);
          #include <colorspace_fragment>
        }`,
    });
    const sheet = new PlaneGeometry(size, size).rotateX(-Math.PI / 2);
    const ground = new Mesh(sheet, this.grid);
    this.shadow = new Mesh(sheet, new ShadowMaterial({ depthWrite: false }));
    this.shadow.receiveShadow = true;
    ground.position.set(centre.x, low, centre.z);
    this.shadow.position.set(centre.x, low - 1e-4 * radius, centre.z);
    ground.renderOrder = -1;
    this.shadow.renderOrder = -2;
    this.scene.add(this.shadow, ground);
  }

  sphere({ centre, radius }) {
    const material = new MeshStandardMaterial({
      roughness: 0.65, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 2,
    });
    const ball = new Mesh(new SphereGeometry(0.995 * radius, 96, 64), material);
    ball.position.set(-centre[0], centre[1], centre[2]);
    ball.receiveShadow = ball.castShadow = true;
    this.balls = [...(this.balls ?? []), ball];
    this.scene.add(ball);
  }

  /** An arrow towards the cloth. */
  wind({ middle, way, size }) {
    const material = new MeshBasicMaterial({ color: WIND, transparent: true, opacity: 0.9 });
    const shaft = new Mesh(new CylinderGeometry(0.018 * size, 0.018 * size, 0.8 * size, 20), material);
    const head = new Mesh(new ConeGeometry(0.06 * size, 0.2 * size, 28), material);
    shaft.position.y = -0.1 * size;
    head.position.y = 0.4 * size;
    const arrow = new Group().add(shaft, head);
    arrow.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), way));
    arrow.position.copy(middle);
    this.arrow = arrow;
    this.scene.add(arrow);
  }

  /** Put colliders and pins that move where they are between a frame and the next; turn and size the wind's arrow. */
  move(frame, share) {
    this.around.spheres.forEach(({ path }, k) => {
      if (!path) return;
      const a = path[frame], b = path[Math.min(frame + 1, path.length - 1)];
      const at = a.map((value, c) => value + share * (b[c] - value));
      this.balls[k].position.set(-at[0], at[1], at[2]);
    });
    this.around.solids.forEach((solid, k) => placeSolid(this.solids[k], solid, frame, share));
    if (this.around.gusts && this.arrow) this.blow(this.around.gusts, frame, share);
    if (!this.around.pinned || !this.pinBalls) return;
    const places = this.fitted.faces.getAttribute("position");
    this.around.held.forEach((vertex, i) => this.pinBalls.setMatrixAt(
      i, new Matrix4().makeTranslation(places.getX(vertex), places.getY(vertex), places.getZ(vertex))));
    this.pinBalls.instanceMatrix.needsUpdate = true;
  }

  blow(gusts, frame, share) {
    const b = gusts[Math.min(frame + 1, gusts.length - 1)];
    const [x, y, z] = gusts[frame].map((value, c) => value + share * (b[c] - value));
    const way = new Vector3(-x, y, z), speed = way.length();
    this.arrow.visible = speed > 0;
    if (speed > 0) this.arrow.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way.divideScalar(speed));
    this.arrow.scale.setScalar(Math.max(speed / this.view.arrow.speed, 0.05));
  }

  /** Balls at the fixed vertices, flat list of places. */
  pins(places) {
    const count = places.length / 3;
    if (count === 0) return;
    const ball = new SphereGeometry(this.view.pin, 16, 12);
    const pins = new InstancedMesh(ball, new MeshStandardMaterial({ color: FIXED, roughness: 0.4 }), count);
    for (let i = 0; i < count; i++) {
      pins.setMatrixAt(i, new Matrix4().makeTranslation(-places[3 * i], places[3 * i + 1], places[3 * i + 2]));
    }
    this.pinBalls = pins;
    this.scene.add(pins);
  }

  /** Colours for a dark or a light page. */
  skin(name) {
    const skin = SKINS[name];
    this.grid.uniforms.tint.value.set(skin.grid);
    this.grid.uniforms.share.value = skin.gridShare;
    this.shadow.material.opacity = skin.shadow;
    this.hemisphere.color.set(skin.sky);
    this.hemisphere.groundColor.set(skin.ground);
    this.hemisphere.intensity = skin.ambient;
    this.key.intensity = skin.key;
    for (const each of [...(this.balls ?? []), ...this.solids]) each.material.color.set(skin.sphere);
    this.stale = true;
  }

  /** Colour the cloths per vertex, or plainly; the target fades beside colours, so that they can be read. */
  paint(mode) {
    const plain = mode === "plain";
    for (const { cloth, shading, solid: { material } } of this.panes) {
      const attribute = shading.choose(mode);
      if (attribute) cloth.faces.setAttribute("color", attribute);
      material.vertexColors = attribute !== null;
      material.color.set(attribute ? "#ffffff" : CLOTH);
      material.needsUpdate = true;
    }
    this.over.paint(plain);
    this.stale = true;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2) * this.ratio);
    this.renderer.setSize(width, height, false);
    const before = this.camera.aspect;
    this.cells = cells(this.panes.filter((pane) => pane.on).length, width, height);
    this.camera.aspect = this.cells[0].width / this.cells[0].height;
    this.camera.updateProjectionMatrix();
    if (!this.fittedOnce || Math.abs(before / this.camera.aspect - 1) > 0.15) this.fit();
    this.fittedOnce = true;
    this.stale = true;
  }

  /** Show everything, from the side on which the cloth is seen best. */
  fit() {
    const { points, radius, azimuth, height } = this.view;
    this.orbit.fit(points, radius, azimuth, height);
  }

  /** Draw finely, or as coarsely as level 1, 2, … of `LEVELS` says. */
  refine(level) {
    if (level === this.level) return;
    this.level = level;
    const [ratio, shadows, edges] = LEVELS[level];
    this.renderer.shadowMap.autoUpdate = shadows;
    this.shadow.visible = shadows;
    this.over.refine(edges);
    this.ratio = level > 0 || this.smooth ? ratio : FINE;
    this.resize();
  }

  /** Let go of the canvas, which another picture takes the place of. */
  dispose() {
    this.observer.disconnect();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** Draw each pane into its cell. */
  render() {
    this.lamp.position.copy(this.camera.position);
    this.renderer.setScissorTest(true);
    const shown = this.panes.filter((pane) => pane.on), { clientHeight: height } = this.canvas.parentElement;
    this.cells.forEach((cell, k) => {
      for (const pane of this.panes) {
        pane.solid.visible = pane === shown[k] && this.clothShown;
        pane.threads.visible = pane === shown[k] && this.threadsShown;
      }
      if (this.controls) this.controls.group.visible = shown[k] === this.panes[0] && this.controlsShown;
      const place = [cell.left, height - cell.top - cell.height, cell.width, cell.height];
      this.renderer.setViewport(...place);
      this.renderer.setScissor(...place);
      this.renderer.render(this.scene, this.camera);
    });
    this.stale = false;
  }
}
