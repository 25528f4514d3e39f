// Moving the camera round a point: drag to turn, with the right button, Shift or two fingers to shift, wheel or two
// fingers to go nearer.

import { Vector3 } from "three";

const STEEPEST = 1.5;  // radians up or down
const MARGIN = 0.83;  // of the picture that points may fill

export class Orbit {
  constructor(camera, element, changed) {
    Object.assign(this, { camera, element, changed, centre: new Vector3(), azimuth: 0.6, height: 0.35, distance: 5 });
    this.pointers = new Map();
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** Look at points, a flat list, from a direction so that they fill the picture but for a margin. */
  fit(points, radius, azimuth, height) {
    Object.assign(this, { azimuth, height, radius, distance: radius });
    this.centre.set(0, 0, 0);
    this.place();
    this.camera.updateMatrixWorld();
    const [right, up, back] = [new Vector3(), new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, back);
    const steep = Math.tan((this.camera.fov * Math.PI) / 360) * MARGIN;
    const [across, a] = balance(points, right, back, steep * this.camera.aspect);
    const [along, b] = balance(points, up, back, steep);
    const nearest = extent(points, back)[1];
    this.centre.addScaledVector(right, across).addScaledVector(up, along);
    const away = Math.max(a, b, nearest + 0.1 * radius);  // of the camera from the origin, along its axis
    const depth = extent(points, back).reduce((sum, end) => sum + end / 2, 0);
    this.centre.addScaledVector(back, depth);
    this.distance = away - depth;
    this.place();
  }

  /** Put the camera where the angles say. */
  place() {
    const { camera, centre, azimuth, height, distance } = this;
    const flat = Math.cos(height) * distance;
    camera.position.set(flat * Math.sin(azimuth), Math.sin(height) * distance, flat * Math.cos(azimuth)).add(centre);
    camera.lookAt(centre);
    camera.near = distance / 200;
    camera.far = distance * 10 + 20 * (this.radius ?? 1);
    camera.updateProjectionMatrix();
    this.changed();
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.height = Math.min(Math.max(this.height + dy, -STEEPEST), STEEPEST);
    this.place();
  }

  shift(dx, dy) {
    const width = (2 * this.distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.element.clientHeight;
    const [right, up] = [new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, new Vector3());
    this.centre.addScaledVector(right, -dx * width).addScaledVector(up, dy * width);
    this.place();
  }

  zoom(factor) {
    const size = this.radius ?? this.distance;
    this.distance = Math.min(Math.max(this.distance * factor, size / 50), size * 20);
    this.place();
  }

  down(event) {
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const away = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
      this.shift(dx / 2, dy / 2);
      this.zoom(away(before) / away(now));
    } else if (event.shiftKey || event.buttons & 6) {
      this.shift(dx, dy);
    } else {
      const pace = 5 / Math.max(this.element.clientHeight, 300);
      this.turn(dx * pace, dy * pace);
    }
    this.pointers.set(event.pointerId, now);
  }

  wheel(event) {
    event.preventDefault();
    this.zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) * 0.0015));
  }
}

/** Smallest and largest coordinate of points along a direction. */
function extent(points, way) {
  let low = Infinity, high = -Infinity;
  for (let i = 0; i < points.length; i += 3) {
    const at = points[i] * way.x + points[i + 1] * way.y + points[i + 2] * way.z;
    low = Math.min(low, at);
    high = Math.max(high, at);
  }
  return [low, high];
}

/** Where along `side` the camera must stand, and how far back, to see all points within the slopes ±steep. */
function balance(points, side, back, steep) {
  let plus = -Infinity, minus = -Infinity;
  for (let i = 0; i < points.length; i += 3) {
    const [x, y, z] = [points[i], points[i + 1], points[i + 2]];
    const at = (x * side.x + y * side.y + z * side.z) / steep, behind = x * back.x + y * back.y + z * back.z;
    plus = Math.max(plus, behind + at);
    minus = Math.max(minus, behind - at);
  }
  return [(steep * (plus - minus)) / 2, (plus + minus) / 2];
}
