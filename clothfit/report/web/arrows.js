// The forces of the present step as arrows from the vertices, and the paths of handles as lines.

import {
  BufferAttribute, BufferGeometry, ConeGeometry, CylinderGeometry, Group, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4,
  MeshLambertMaterial, Quaternion, Vector3,
} from "three";

const FORCE = "#e4572e", PATH = "#f5a524";
const MOST = 1500;  // arrows; of more vertices every k-th has one
const LONGEST = 0.26, SHORTEST = 0.006, THICK = 0.0035;  // relative to the picture's radius
const UP = new Vector3(0, 1, 0), NOWHERE = new Matrix4().makeScale(0, 0, 0);

export class Arrows {
  /** `control` has forces, unpacked, largest, N, and handles; `cloth` is what they push; `radius` of the picture, m. */
  constructor({ forces, largest, handles }, cloth, radius) {
    Object.assign(this, { forces, cloth, radius, group: new Group() });
    this.scale = largest > 0 ? (LONGEST * radius) / largest : 0;
    const pushed = this.pushed();
    this.vertices = pushed.filter((_, i) => i % Math.max(Math.ceil(pushed.length / MOST), 1) === 0);
    const thick = THICK * radius, colour = new MeshLambertMaterial({ color: FORCE, emissive: FORCE, emissiveIntensity: 0.45 });
    const shaft = new CylinderGeometry(thick, thick, 1, 8).translate(0, 0.5, 0);
    const head = new ConeGeometry(3 * thick, 9 * thick, 12).translate(0, 4.5 * thick, 0);
    this.head = 9 * thick;
    [this.shafts, this.heads] = [shaft, head].map((shape) => new InstancedMesh(shape, colour, Math.max(this.vertices.length, 1)));
    for (const each of [this.shafts, this.heads]) {
      each.frustumCulled = false;
      each.setMatrixAt(0, NOWHERE);
      this.group.add(each);
    }
    for (const path of handles) this.group.add(line(path));
  }

  /** The vertices that a force acts on at any time. */
  pushed() {
    const { vertices, frames } = this.forces, found = [];
    for (let i = 0; i < vertices; i++) {
      for (let frame = 0; frame < frames; frame++) {
        if (this.of(frame, i).length() * this.scale < SHORTEST * this.radius) continue;
        found.push(i);
        break;
      }
    }
    return found;
  }

  /** The force on a vertex in the step that begins at a frame, N, turned round as the picture is. */
  of(frame, vertex) {
    const { grid, vertices, low, step } = this.forces, at = 3 * (frame * vertices + vertex);
    return new Vector3(-low[0] - step[0] * grid[at], low[1] + step[1] * grid[at + 1], low[2] + step[2] * grid[at + 2]);
  }

  /** Put the arrows of a frame where the cloth is. */
  move(frame) {
    const x = this.cloth.positions, turn = new Quaternion(), place = new Vector3(), size = new Vector3(), matrix = new Matrix4();
    this.vertices.forEach((vertex, i) => {
      const way = this.of(frame, vertex), long = way.length() * this.scale;
      if (long < SHORTEST * this.radius) {
        for (const each of [this.shafts, this.heads]) each.setMatrixAt(i, NOWHERE);
        return;
      }
      turn.setFromUnitVectors(UP, way.normalize());
      const head = Math.min(this.head, 0.6 * long), share = head / this.head;
      place.set(x[3 * vertex], x[3 * vertex + 1], x[3 * vertex + 2]);
      this.shafts.setMatrixAt(i, matrix.compose(place, turn, size.set(share, long - head, share)));
      this.heads.setMatrixAt(i, matrix.compose(place.addScaledVector(way, long - head), turn, size.setScalar(share)));
    });
    for (const each of [this.shafts, this.heads]) each.instanceMatrix.needsUpdate = true;
  }
}

/** A path of points, in the scene's axes. */
function line(path) {
  const pairs = path.slice(1).flatMap((to, i) => [path[i], to]);
  const points = Float32Array.from(pairs.flatMap(([x, y, z]) => [-x, y, z]));
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color: PATH }));
}
