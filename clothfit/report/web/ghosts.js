// The keys of a controlled motion: a ghost of the cloth for each, the next one stronger; balls where means are to be.

import { Group, Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import { Cloth } from "clothfit/cloth";
import { TARGET, Veil } from "clothfit/veils";

const FEW = 4;  // keys that are all shown; of more the next one and the one before
const FAINT = 0.28;  // opacity of a ghost whose time has not come or is over, as a share

export class Ghosts {
  /** `control` has due (frames), ghosts (which keys have one), poses, asked and means; `size` of a ball, m. */
  constructor({ due, ghosts, poses, asked, means }, triangles, edges, size) {
    Object.assign(this, { due, ghosts, group: new Group() });
    const { grid, vertices, low, step } = poses, row = 3 * vertices;
    this.veils = ghosts.map((_, k) => {
      const motion = { grid: grid.subarray(k * row, (k + 1) * row), frames: 1, vertices, low, step };
      const flags = asked.subarray(k * vertices, (k + 1) * vertices);
      const cloth = new Cloth(motion, triangles, edges, flags.every(Boolean) ? null : flags);
      cloth.move(0, 0);
      return new Veil(cloth);
    });
    this.balls = means.map((places) => {
      const group = new Group();
      for (const [x, y, z] of places) {
        const ball = new Mesh(new SphereGeometry(size, 24, 16), new MeshBasicMaterial({ color: TARGET, transparent: true }));
        ball.position.set(-x, y, z);
        group.add(ball);
      }
      return group;
    });
    this.group.add(...this.veils.map(({ group }) => group), ...this.balls);
    this.move(0, 0);
  }

  /** Which key comes next at a place between frames; the last one after all. */
  next(frame, share) {
    const found = this.due.findIndex((due) => due >= frame + share - 1e-9);
    return found < 0 ? this.due.length - 1 : found;
  }

  move(frame, share) {
    const next = this.next(frame, share), few = this.due.length <= FEW;
    const shown = (k) => few || k === next || k === next - 1;
    this.ghosts.forEach((k, i) => {
      this.veils[i].group.visible = shown(k);
      this.veils[i].fade(k === next ? 1 : FAINT);
    });
    this.balls.forEach((group, k) => {
      group.visible = shown(k);
      for (const ball of group.children) ball.material.opacity = k === next ? 0.9 : FAINT;
    });
  }

  paint(plain) {
    for (const veil of this.veils) veil.paint(plain);
  }

  refine(edges) {
    for (const veil of this.veils) veil.refine(edges);
  }
}
