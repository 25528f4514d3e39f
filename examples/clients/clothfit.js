// A client of `clothfit serve` in JavaScript, without packages: for browsers, and for Node.js from 22 on; older ones
// need `new Clothfit(address, { WebSocket })` with a WebSocket of theirs. docs/serve.md has messages and frames.
//
//   const live = new Clothfit("http://127.0.0.1:8000/?token=…");
//   await live.ready;
//   await live.send("play");
//   const { number, positions } = live.latest();  // never waits

const HEADER = 24; // bytes before the positions

export class Clothfit {
  /** `address` is the line that `clothfit serve` prints. */
  constructor(address, { WebSocket = globalThis.WebSocket } = {}) {
    const place = new URL(address);
    place.protocol = "ws:";
    place.pathname = "/ws";
    this.scene = null; // the last `scene` message
    this.target = null; // {frames, step, positions} of the target, where there is one
    this.onmessage = null; // is called with each message that is no answer
    this.frame = null;
    this.waiting = new Map();
    this.last = 0;
    this.socket = new WebSocket(place.href);
    this.socket.binaryType = "arraybuffer";
    this.ready = new Promise((resolve, reject) => {
      this.resolve = resolve;
      this.socket.addEventListener("error", () => reject(new Error(`${place.host}: no server answers, or it refuses`)));
    });
    this.socket.addEventListener("message", ({ data }) => (typeof data === "string" ? this.#text(data) : this.#binary(data)));
    this.socket.addEventListener("close", () => {
      for (const { reject } of this.waiting.values()) reject(new Error("the connection is closed"));
      this.waiting.clear();
    });
  }

  /** The newest frame that has come: {number, time, generation, positions}, x, y, z of each vertex, m. Never waits. */
  latest() {
    return this.frame;
  }

  /** Send a message; the promise has its answer, or fails with the reason why it was refused. */
  send(type, fields = {}) {
    const id = ++this.last;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.socket.send(JSON.stringify({ type, id, ...fields }));
    });
  }

  close() {
    this.socket.close(1000);
  }

  #text(data) {
    const message = JSON.parse(data);
    const waiting = this.waiting.get(message.id);
    if (message.type === "scene") this.scene = message;
    if (waiting) {
      this.waiting.delete(message.id);
      if (message.type === "refused") waiting.reject(new Error(message.reason));
      else waiting.resolve(message);
    } else this.onmessage?.(message);
    this.#begin();
  }

  #binary(data) {
    const view = new DataView(data);
    const kind = String.fromCharCode(...new Uint8Array(data, 0, 4));
    const generation = view.getUint32(4, true), number = Number(view.getBigUint64(8, true)), time = view.getFloat64(16, true);
    const positions = new Float32Array(data, HEADER); // little-endian, as all processors of today are
    if (kind === "CFF1") this.frame = { number, time, generation, positions };
    if (kind === "CFT1") this.target = { frames: number, step: time, positions };
    this.#begin();
  }

  #begin() {
    if (this.scene && this.frame) this.resolve();
  }
}
