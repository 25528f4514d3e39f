// Time: which frame is shown, how fast time passes, and its controls.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

export class Player {
  /** `times`, s, of the frames; `show(frame, share)` draws; `reached(frame)` is called when the frame changes. */
  constructor(times, show, reached) {
    Object.assign(this, { times, show, reached, time: times[0], playing: false, speed: 1, frame: -1 });
    this.last = times[times.length - 1];
  }

  /** The frame at or before a time, and how far the time is to the next. */
  place(time) {
    const { times } = this;
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time) low = middle; else high = middle - 1;
    }
    const gap = low + 1 < times.length ? times[low + 1] - times[low] : 1;
    return [low, Math.min(Math.max((time - times[low]) / gap, 0), 1)];
  }

  goTo(time) {
    this.time = Math.min(Math.max(time, this.times[0]), this.last);
    const [frame, share] = this.place(this.time);
    this.show(frame, frame + 1 < this.times.length ? share : 0);
    if (frame !== this.frame) {
      this.frame = frame;
      this.reached(frame);
    }
  }

  goToFrame(frame) {
    this.goTo(this.times[Math.min(Math.max(frame, 0), this.times.length - 1)]);
  }

  step(frames) {
    this.pause();
    this.goToFrame(this.frame + frames);
  }

  play() {
    if (this.times.length < 2) return;
    if (this.time >= this.last) this.time = this.times[0];
    this.playing = true;
    this.changed?.();
  }

  pause() {
    this.playing = false;
    this.changed?.();
  }

  toggle() {
    if (this.playing) this.pause(); else this.play();
  }

  /** Let seconds of real time pass; after the end it begins again. */
  pass(seconds) {
    if (!this.playing) return;
    const time = this.time + seconds * this.speed;
    this.goTo(time > this.last ? this.times[0] : time);
  }

  faster(steps) {
    const at = SPEEDS.indexOf(this.speed);
    this.speed = SPEEDS[Math.min(Math.max(at + steps, 0), SPEEDS.length - 1)];
    this.changed?.();
  }
}

export { SPEEDS };
