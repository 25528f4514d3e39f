// A cloth on the screen: positions at any time between two frames, normals, and which faces to show.
//
// The scene's x axis is turned round: its world is left-handed, that of three.js right-handed.

import { BufferAttribute, BufferGeometry, DynamicDrawUsage } from "three";

export class Cloth {
  /** `motion` as unpackedPositions gives it; `triangles` and `edges` are flat lists of vertices; `observed` has a flag
   * per frame and vertex, or is null. */
  constructor(motion, triangles, edges, observed = null) {
    Object.assign(this, { motion, triangles, edges, observed });
    this.shownFrame = -1;
    this.positions = new Float32Array(3 * motion.vertices);
    this.normals = new Float32Array(3 * motion.vertices);
    const position = dynamic(this.positions, 3);
    [this.faces, this.lines, this.dots] = [triangles.length, edges.length, motion.vertices].map((count) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", position);
      geometry.setIndex(dynamic(new Uint32Array(count), 1));
      return geometry;
    });
    this.faces.setAttribute("normal", dynamic(this.normals, 3));
    this.show(() => true);
  }

  /** Move to a place in time: `frame` and how far, 0 … 1, to the next one. */
  move(frame, share) {
    const { grid, vertices, frames, low, step } = this.motion;
    const row = 3 * vertices, a = frame * row, b = Math.min(frame + 1, frames - 1) * row;
    const x = this.positions;
    const [sx, sy, sz] = [-step[0], step[1], step[2]], [ox, oy, oz] = [-low[0], low[1], low[2]];
    for (let i = 0; i < row; i += 3) {
      const gx = grid[a + i], gy = grid[a + i + 1], gz = grid[a + i + 2];
      x[i] = ox + sx * (gx + share * (grid[b + i] - gx));
      x[i + 1] = oy + sy * (gy + share * (grid[b + i + 1] - gy));
      x[i + 2] = oz + sz * (gz + share * (grid[b + i + 2] - gz));
    }
    this.hide(frame);
    this.turnNormals();
    this.faces.attributes.position.needsUpdate = true;
    this.faces.attributes.normal.needsUpdate = true;
  }

  /** Vertex normals: the sum of those of the faces, each as long as twice its face is large, made one long. */
  turnNormals() {
    const { positions: x, normals: n } = this;
    const index = this.faces.index.array, count = this.faces.drawRange.count;
    n.fill(0);
    for (let t = 0; t < count; t += 3) {
      const a = 3 * index[t], b = 3 * index[t + 1], c = 3 * index[t + 2];
      const ux = x[b] - x[a], uy = x[b + 1] - x[a + 1], uz = x[b + 2] - x[a + 2];
      const vx = x[c] - x[a], vy = x[c + 1] - x[a + 1], vz = x[c + 2] - x[a + 2];
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      n[a] += nx; n[a + 1] += ny; n[a + 2] += nz;
      n[b] += nx; n[b + 1] += ny; n[b + 2] += nz;
      n[c] += nx; n[c + 1] += ny; n[c + 2] += nz;
    }
    for (let i = 0; i < n.length; i += 3) {
      const size = 1 / (Math.sqrt(n[i] * n[i] + n[i + 1] * n[i + 1] + n[i + 2] * n[i + 2]) || 1);
      n[i] *= size; n[i + 1] *= size; n[i + 2] *= size;
    }
  }

  /** Show only what was observed at a frame. */
  hide(frame) {
    if (!this.observed || frame === this.shownFrame) return;
    this.shownFrame = frame;
    const first = frame * this.motion.vertices;
    this.show((vertex) => this.observed[first + vertex]);
  }

  /** Show the faces, edges and vertices of which all vertices are seen. The faces of a world that is turned round are
   * turned inside out, so two of their corners change places. */
  show(seen) {
    const { triangles, edges, motion } = this;
    const [faces, lines, dots] = [this.faces, this.lines, this.dots].map((geometry) => geometry.index.array);
    let kept = 0;
    for (let t = 0; t < triangles.length; t += 3) {
      const a = triangles[t], b = triangles[t + 1], c = triangles[t + 2];
      if (!(seen(a) && seen(b) && seen(c))) continue;
      faces[kept] = a; faces[kept + 1] = c; faces[kept + 2] = b;
      kept += 3;
    }
    shorten(this.faces, kept);
    kept = 0;
    for (let e = 0; e < edges.length; e += 2) {
      if (!(seen(edges[e]) && seen(edges[e + 1]))) continue;
      lines[kept] = edges[e]; lines[kept + 1] = edges[e + 1];
      kept += 2;
    }
    shorten(this.lines, kept);
    kept = 0;
    for (let i = 0; i < motion.vertices; i++) if (seen(i)) dots[kept++] = i;
    shorten(this.dots, kept);
  }
}

/** The edges of triangles, each once, as a flat list of vertices; the springs where there are no triangles. */
export function edgesOf(triangles, springs, vertices) {
  if (triangles.length === 0) return springs;
  const met = new Set(), found = [];
  for (let t = 0; t < triangles.length; t++) {
    const a = triangles[t], b = triangles[t % 3 === 2 ? t - 2 : t + 1];
    const key = Math.min(a, b) * vertices + Math.max(a, b);
    if (met.has(key)) continue;
    met.add(key);
    found.push(a, b);
  }
  return Uint32Array.from(found);
}

function shorten(geometry, count) {
  geometry.setDrawRange(0, count);
  geometry.index.needsUpdate = true;
}

function dynamic(array, size) {
  const attribute = new BufferAttribute(array, size);
  attribute.setUsage(DynamicDrawUsage);
  return attribute;
}
