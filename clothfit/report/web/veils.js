// A translucent cloth over others: the target of a fit, or the pose that a key asks for.

import { DoubleSide, Group, LineBasicMaterial, LineSegments, Mesh, MeshLambertMaterial, Points, PointsMaterial } from "three";

export const TARGET = "#17c964";
const FACES = 0.3, EDGES = 0.55, BESIDE_COLOURS = 0.3;  // opacities

/** Faces, edges and observed vertices of a cloth. */
export class Veil {
  constructor(cloth) {
    this.cloth = cloth;
    this.bare = cloth.triangles.length === 0;
    const veil = new MeshLambertMaterial({
      color: TARGET, emissive: TARGET, emissiveIntensity: 0.12, side: DoubleSide, transparent: true,
      opacity: FACES, depthWrite: false, polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1,
    });
    this.faces = new Mesh(cloth.faces, veil);
    this.hem = new LineSegments(cloth.lines, lines(TARGET, EDGES));
    const size = Math.max(4, 9 - Math.log2(cloth.motion.vertices) / 2);
    this.seen = new Points(cloth.dots, new PointsMaterial({ color: TARGET, size, sizeAttenuation: false, transparent: true }));
    this.seen.visible = cloth.observed !== null || this.bare;
    this.group = new Group().add(this.faces, this.hem, this.seen);
    this.group.children.forEach((each, order) => {
      each.frustumCulled = false;  // its box would be out of date
      each.renderOrder = 1 + order;
    });
    this.share = 1;
    this.paint(true);
  }

  /** Plain, or faded beside colours, so that they can be read. */
  paint(plain) {
    this.plain = plain;
    this.faces.visible = plain;
    this.faces.material.opacity = FACES * this.share;
    this.hem.material.opacity = (plain ? EDGES : BESIDE_COLOURS) * this.share;
    this.seen.material.opacity = this.share;
  }

  /** With edges, or without, as a slow machine wants it. */
  refine(edges) {
    this.hem.visible = edges || this.bare;
  }

  /** Fade to a share of the usual opacity. */
  fade(share) {
    if (share === this.share) return;
    this.share = share;
    this.paint(this.plain);
  }
}

export function lines(color, opacity) {
  return new LineBasicMaterial({ color, opacity, transparent: true, depthWrite: false });
}
