// Reads the records that clothfit/report/packing.py writes: deflated arrays in base64, motions on a grid of 16 bits.

const TYPES = { float32: Float32Array, uint32: Uint32Array, int32: Int32Array, uint8: Uint8Array };

async function inflated(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** An array of numbers, row after row. */
export async function unpacked(record) {
  const bytes = await inflated(record.data);
  return new TYPES[record.type](bytes.buffer);
}

/** Positions on their grid: {grid: Uint16Array, frames, vertices, low, step}; x = low + step · grid. */
export async function unpackedPositions(record) {
  const bytes = await inflated(record.data);
  const [frames, vertices] = record.shape;
  const count = bytes.length / 2, row = 3 * vertices;
  const grid = new Uint16Array(count);
  for (let i = 0; i < count; i++) {
    const folded = bytes[i] | (bytes[count + i] << 8);
    grid[i] = (folded >>> 1) ^ -(folded & 1);
  }
  for (let pass = 0; pass < 2; pass++) for (let i = row; i < count; i++) grid[i] += grid[i - row];
  return { grid, frames, vertices, low: record.low, step: record.step };
}

/** Errors, m, as grades: {grades: Uint8Array, most}; error = most · (grade / 255)². */
export async function unpackedErrors(record) {
  return { grades: await inflated(record.data), most: record.most };
}

/** Flags, one byte each, from 8 in a byte. */
export async function unpackedFlags(record) {
  if (!record) return null;
  const bits = await inflated(record.data);
  const flags = new Uint8Array(record.shape.reduce((a, b) => a * b, 1));
  for (let i = 0; i < flags.length; i++) flags[i] = (bits[i >> 3] >> (i & 7)) & 1;
  return flags;
}
