// Colliders that are drawn as triangles: planes, capsules, boxes, meshes.
//
// As with cloths the x axis is turned round, and with it the order of a triangle's vertices and two parts of a turn.

import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshStandardMaterial, Quaternion, Vector3 } from "three";

/** The mesh of a solid with unpacked points, triangles and tones. It is drawn `give` metres behind its place, as the
 * faces of a cloth that lies on it cut through it between their vertices. */
export function solidMesh({ points, triangles, tone }, give) {
  const count = points.length / 3, geometry = new BufferGeometry();
  const flipped = points.map((value, i) => (i % 3 === 0 ? -value : value));
  const colour = new Float32Array(3 * count).map((_, i) => tone[Math.floor(i / 3)]);
  const index = Uint32Array.from(triangles, (_, i) => triangles[i % 3 === 0 ? i : i % 3 === 1 ? i + 1 : i - 1]);
  geometry.setAttribute("position", new BufferAttribute(flipped, 3));
  geometry.setAttribute("color", new BufferAttribute(colour, 3));
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.computeVertexNormals();
  const material = new MeshStandardMaterial({ roughness: 0.65, vertexColors: true, side: DoubleSide });
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader.replace("#include <project_vertex>", `#include <project_vertex>
      vec4 behind = projectionMatrix * (mvPosition - vec4(0.0, 0.0, ${give.toExponential(6)}, 0.0));
      gl_Position.z = behind.z / behind.w * gl_Position.w;`);
  };
  const mesh = new Mesh(geometry, material);
  mesh.receiveShadow = mesh.castShadow = true;
  return mesh;
}

/** Put a mesh where its solid is between a frame and the next. */
export function placeSolid(mesh, { places, turns, paths }, frame, share) {
  const [a, b] = [frame, frame + 1].map((at) => Math.min(at, places.length - 1));
  mesh.position.copy(placeOf(places[a]).lerp(placeOf(places[b]), share));
  mesh.quaternion.copy(turnOf(turns[a]).slerp(turnOf(turns[b]), share));
  if (paths) bend(mesh.geometry, paths, frame, share);
}

/** Put the points of a geometry where their paths are between a frame and the next. */
function bend(geometry, { grid, frames, vertices, low, step }, frame, share) {
  const points = geometry.getAttribute("position"), row = 3 * vertices;
  const [a, b] = [frame, frame + 1].map((at) => row * Math.min(at, frames - 1));
  for (let i = 0; i < row; i++) {
    const axis = i % 3, q = grid[a + i] + share * (grid[b + i] - grid[a + i]);
    points.array[i] = (axis === 0 ? -1 : 1) * (low[axis] + step[axis] * q);
  }
  points.needsUpdate = true;
  geometry.computeVertexNormals();
  geometry.computeBoundingSphere();
}

/** Its points at the start, turned round as the picture is, flat. */
export function solidPoints({ points, places, turns }) {
  const found = [], place = placeOf(places[0]), turn = turnOf(turns[0]);
  for (let i = 0; i < points.length; i += 3) {
    found.push(...new Vector3(-points[i], points[i + 1], points[i + 2]).applyQuaternion(turn).add(place).toArray());
  }
  return found;
}

const placeOf = (p) => new Vector3(-p[0], p[1], p[2]);
const turnOf = (q) => new Quaternion(q[0], -q[1], -q[2], q[3]);
