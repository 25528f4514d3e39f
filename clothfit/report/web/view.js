// From where to look: the box of the motion, and the side from which most of the cloth is seen.

import { Vector3 } from "three";
import { solidPoints } from "clothfit/solids";

const SIDES = 24, HEIGHT = 0.32, LOOKS = 4;
const BESIDE = 1.5;  // times the size of the cloth's motion up to which what it touches is in the picture as a whole, too
const GIVE = 0.35;  // of an edge: how far behind their place solids are drawn

/** Points to look at, their middle and radius, the ground's height and cells, a pin's size, the angles of the best view,
 * turned `aside`: what stands upright on a cloth is hardly seen from before it. */
export function viewOf(motions, cloth, { spheres, solids, wind, gusts }, edges, aside = 0) {
  const points = motions.flatMap(pointsOf);
  const size = radiusOf(points, middleOf(points));
  const arrow = arrowOf(strongest(gusts ?? [wind]), points, size);
  for (const sphere of spheres) if (sphere.radius < BESIDE * size) points.push(...ballPoints(sphere));
  for (const solid of solids.filter(({ endless }) => !endless)) {
    const corners = solidPoints(solid);
    if (radiusOf(corners, middleOf(corners)) < BESIDE * size) points.push(...corners);
  }
  const centre = middleOf(points), radius = radiusOf(points, centre) || 1;
  let lowest = Infinity;
  for (let i = 1; i < points.length; i += 3) lowest = Math.min(lowest, points[i]);
  return {
    points, arrow, centre, radius, low: lowest - 0.01 * radius, cell: round(radius / 5),
    pin: Math.min(0.22 * edgeLength(cloth, edges), 0.02 * radius) || 0.01 * radius,
    give: GIVE * edgeLength(cloth, edges), ...bestSide(cloth, aside),
  };
}

/** Some of the places of a motion, turned round as the picture is. */
function pointsOf({ grid, low, step, frames, vertices }) {
  const found = [];
  for (let look = 0; look < Math.min(frames, 60); look++) {
    const frame = Math.round((look / Math.max(Math.min(frames, 60) - 1, 1)) * (frames - 1));
    const every = Math.ceil(vertices / 60);
    for (let vertex = look % every; vertex < vertices; vertex += every) {
      const at = 3 * (frame * vertices + vertex);
      found.push(-low[0] - step[0] * grid[at], low[1] + step[1] * grid[at + 1], low[2] + step[2] * grid[at + 2]);
    }
  }
  return found;
}

const strongest = (winds) => winds.reduce((most, each) => (Math.hypot(...each) > Math.hypot(...most) ? each : most));

/** Where an arrow for the wind stands: before the cloth, towards its middle; its ends go to the points. */
function arrowOf(wind, points, radius) {
  if (Math.hypot(...wind) === 0) return null;
  const way = new Vector3(-wind[0], wind[1], wind[2]).normalize(), middle = middleOf(points), size = 0.42 * radius;
  let first = Infinity;
  for (let i = 0; i < points.length; i += 3) {
    first = Math.min(first, new Vector3(points[i], points[i + 1], points[i + 2]).sub(middle).dot(way));
  }
  middle.addScaledVector(way, first - 0.62 * size);
  for (const end of [-0.5, 0.5]) points.push(...middle.clone().addScaledVector(way, end * size).toArray());
  return { middle, way, size, speed: Math.hypot(...wind) };
}

function ballPoints({ centre, radius }) {
  const found = [];
  for (let i = 0; i < 64; i++) {
    const y = 1 - (2 * (i + 0.5)) / 64, flat = Math.sqrt(1 - y * y), angle = 2.4 * i;
    found.push(-centre[0] + radius * flat * Math.cos(angle), centre[1] + radius * y, centre[2] + radius * flat * Math.sin(angle));
  }
  return found;
}

/** The middle of the box of points. */
function middleOf(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  points.forEach((value, i) => {
    low[i % 3] = Math.min(low[i % 3], value);
    high[i % 3] = Math.max(high[i % 3], value);
  });
  return new Vector3(...low.map((value, c) => (value + high[c]) / 2));
}

function radiusOf(points, centre) {
  let most = 0;
  for (let i = 0; i < points.length; i += 3) {
    most = Math.max(most, Math.hypot(points[i] - centre.x, points[i + 1] - centre.y, points[i + 2] - centre.z));
  }
  return most;
}

/** The power of ten, or twice or five times one, next below a length. */
function round(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [5, 2, 1].find((m) => m * power <= length);
}

function edgeLength(cloth, edges) {
  const x = cloth.positions;
  let sum = 0;
  for (let e = 0; e < edges.length; e += 2) {
    const a = 3 * edges[e], b = 3 * edges[e + 1];
    sum += Math.hypot(x[a] - x[b], x[a + 1] - x[b + 1], x[a + 2] - x[b + 2]);
  }
  return edges.length ? (2 * sum) / edges.length : 0;
}

/** The angles from which the faces, at a few times, cover most of the picture; the front side rather than the back. */
function bestSide(cloth, aside) {
  const scores = new Float64Array(SIDES);
  for (let look = 0; look < LOOKS; look++) {
    cloth.move(Math.round((look / (LOOKS - 1)) * (cloth.motion.frames - 1)), 0);
    const n = cloth.normals;
    for (let side = 0; side < SIDES; side++) {
      const angle = (2 * Math.PI * side) / SIDES;
      const to = [Math.cos(HEIGHT) * Math.sin(angle), Math.sin(HEIGHT), Math.cos(HEIGHT) * Math.cos(angle)];
      for (let i = 0; i < n.length; i += 3) scores[side] += Math.abs(n[i] * to[0] + n[i + 1] * to[1] + n[i + 2] * to[2]);
    }
  }
  const liking = (side) => scores[side] * (1 + 0.06 * Math.cos((2 * Math.PI * side) / SIDES - 0.6));
  let best = 0;
  for (let side = 1; side < SIDES; side++) if (liking(side) > liking(best)) best = side;
  return { azimuth: (2 * Math.PI * best) / SIDES + aside, height: HEIGHT };
}
