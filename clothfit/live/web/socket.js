// The connection: frames, messages, answers. It comes back by itself when it was lost.

const AGAIN = 1000;  // ms until another try
const HEADER = 24;  // bytes of a binary message; docs/serve.md has the layout

/** A binary message: {kind, generation, number, time, positions: Float32Array}. */
export function unpackedPacket(buffer) {
  const view = new DataView(buffer);
  const kind = String.fromCharCode(...new Uint8Array(buffer, 0, 4));
  return { kind, generation: view.getUint32(4, true), number: Number(view.getBigUint64(8, true)),
           time: view.getFloat64(16, true), positions: new Float32Array(buffer, HEADER) };
}

export class Link {
  /** `heard(message)` gets each message, `shown(packet)` each binary one, `state(connected)` is called when that changes. */
  constructor(address, { heard, shown, state }) {
    Object.assign(this, { address, heard, shown, state, last: 0, waiting: new Map() });
    this.open();
  }

  open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("open", () => this.state(true));
    this.socket.addEventListener("message", ({ data }) => {
      if (typeof data !== "string") return this.shown(unpackedPacket(data));
      const message = JSON.parse(data);
      const waiting = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (waiting) waiting(message); else this.heard(message);
    });
    this.socket.addEventListener("close", () => {
      for (const waiting of this.waiting.values()) waiting({ type: "refused", reason: "the connection was lost" });
      this.waiting.clear();
      this.state(false);
      setTimeout(() => this.open(), AGAIN);
    });
  }

  /** Send a message; the promise has its answer, done or refused. */
  ask(type, fields = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ type: "refused", reason: "there is no connection" });
    const id = ++this.last;
    return new Promise((answered) => {
      this.waiting.set(id, answered);
      this.socket.send(JSON.stringify({ type, id, ...fields }));
    });
  }
}

/** Sends the newest of what is offered, one at a time: what comes while an answer is awaited replaces what waits. */
export class Latest {
  constructor(send) {
    Object.assign(this, { send, next: null, busy: false });
  }

  async offer(value) {
    this.next = value;
    if (this.busy) return;
    this.busy = true;
    while (this.next !== null) {
      const now = this.next;
      this.next = null;
      await this.send(now);
    }
    this.busy = false;
  }
}
