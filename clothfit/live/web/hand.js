// Pulling the cloth by hand: the vertex under the pointer follows it, in the plane that faces the camera there.

import { Vector3 } from "three";

const NEAR = { mouse: 16, pen: 20, touch: 30 };  // pixels from a vertex

export class Hand {
  /** `held()` is called when a vertex is taken, `pulled(vertex, place)` with a place of the scene, m, while it is pulled, and
   * `released()` at the end. */
  constructor(element, { picture, held, pulled, released }) {
    Object.assign(this, { element, picture, held, pulled, released, on: true, vertex: null, touched: new Set(), pointer: null });
    const listen = (name, act) => element.addEventListener(name, act, { capture: true });
    listen("pointerdown", (event) => this.down(event));
    listen("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) listen(name, (event) => this.up(event));
  }

  /** The vertex under a pointer that is nearest to the eye, or null. */
  under(event) {
    const { stage, live } = this.picture();
    if (!stage || !this.on || event.target !== stage.canvas) return null;
    const box = stage.canvas.getBoundingClientRect(), x = live.positions, at = new Vector3();
    const near = NEAR[event.pointerType] ?? NEAR.mouse;
    let best = null, least = Infinity;
    for (let i = 0; i < x.length; i += 3) {
      at.set(x[i], x[i + 1], x[i + 2]).project(stage.camera);
      const away = Math.hypot(((at.x + 1) / 2) * box.width - (event.clientX - box.left),
                              ((1 - at.y) / 2) * box.height - (event.clientY - box.top));
      if (away > near || Math.abs(at.z) > 1) continue;
      const score = away / near + 40 * at.z;  // of two layers, the one in front
      if (score < least) [best, least] = [i / 3, score];
    }
    return best;
  }

  /** Where a pointer is in the plane, in the axes of the scene. */
  place(event) {
    const { stage } = this.picture();
    const box = stage.canvas.getBoundingClientRect(), eye = stage.camera.position;
    const [x, y] = [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
    const way = new Vector3(x, y, 0.5).unproject(stage.camera).sub(eye);
    const along = this.normal.dot(way), share = this.normal.dot(this.at.clone().sub(eye)) / along;
    if (!(share > 0)) return null;
    const found = way.multiplyScalar(share).add(eye);
    return [-found.x, found.y, found.z];
  }

  down(event) {
    if (this.vertex !== null || event.button > 0 || event.shiftKey) return;
    const vertex = this.under(event);
    if (vertex === null) return;
    const { stage, live } = this.picture();
    const at = new Vector3(...live.positions.slice(3 * vertex, 3 * vertex + 3));
    const normal = stage.camera.getWorldDirection(new Vector3());
    Object.assign(this, { vertex, pointer: event.pointerId, at, normal });
    this.touched.add(vertex);
    stage.canvas.setPointerCapture(event.pointerId);
    stage.canvas.focus({ preventScroll: true });
    this.element.classList.add("pulling");
    event.stopPropagation();
    this.held();
    this.move(event);
  }

  move(event) {
    if (this.vertex === null) {
      if (!event.buttons) this.element.classList.toggle("reaching", this.under(event) !== null);
      return;
    }
    event.stopPropagation();
    if (event.pointerId !== this.pointer) return;
    const place = this.place(event);
    if (place) this.pulled(this.vertex, place);
  }

  up(event) {
    if (this.vertex === null || event.pointerId !== this.pointer) return;
    this.vertex = this.pointer = null;
    this.element.classList.remove("pulling");
    this.released();
  }
}
