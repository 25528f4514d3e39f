// How finely the picture is drawn: as finely as this machine can while the cloth moves, and in full when it rests.
//
// Pictures that take long hold up what comes after them: a slider that is moved would be seen to act late.

import { LEVELS } from "clothfit/stage";

const LATE = 30;  // ms between two pictures from which on the machine is too slow …
const OFTEN = 6;  // … if it is so for that many in a row
const REST = 400;  // ms without a change after which the picture rests
const SLOW = 2;  // the level at which a processor that draws by itself begins

/** Whether a processor draws, not a graphics card. */
export function drawnBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const named = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = named ? String(gl.getParameter(named.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

export class Pace {
  constructor(slow) {
    Object.assign(this, { level: slow ? SLOW : 0, late: 0, before: 0, changed: 0 });
  }

  /** Note a tick of the screen at `now`, ms, and whether something has changed; returns the level to draw at. */
  tick(now, stale) {
    const passed = now - this.before, moving = stale && now - this.changed < REST;
    this.before = now;
    if (stale) this.changed = now;
    this.late = moving && passed > LATE ? this.late + 1 : moving ? Math.max(this.late - 1, 0) : 0;
    if (this.late > OFTEN) [this.level, this.late] = [Math.min(this.level + 1, LEVELS.length - 1), 0];
    return now - this.changed < REST ? this.level : 0;
  }
}
