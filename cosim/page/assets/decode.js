// Columns of numbers, as cosim/page/encoding.py writes them.

/** Bytes from base64 of deflated ones. */
async function inflatedText(text) {
  const octets = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([octets]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Bytes of a block of the page. */
function inflated(id) {
  return inflatedText(document.getElementById(id).textContent);
}

/** 32-bit floats from the second differences of their bits; `octets` has those of equal weight side by side. */
function floats(octets, n) {
  const bits = new Int32Array(n);
  let value = 0;
  let difference = 0;
  for (let i = 0; i < n; i++) {
    const folded = octets[i] | (octets[n + i] << 8) | (octets[2 * n + i] << 16) | (octets[3 * n + i] << 24);
    difference = (difference + ((folded >>> 1) ^ -(folded & 1))) | 0;
    value = (value + difference) | 0;
    bits[i] = value;
  }
  return new Float32Array(bits.buffer);
}

/** Values of a column for plots: numbers, and null where there is none. */
function valuesOf(raw, { offset = 0, scale = 1 }) {
  const whole = raw.every(Number.isFinite);
  if (offset === 0 && scale === 1) return whole ? raw : Array.from(raw, (v) => (Number.isFinite(v) ? v : null));
  const value = (v) => (Number.isFinite(v) ? offset + scale * v : null);
  return whole ? Float64Array.from(raw, value) : Array.from(raw, value);
}

/** Columns one after the other; `columns` has the number of rows, offset and scale of each. */
function columnsIn(octets, columns) {
  let at = 0;
  return columns.map((column) => {
    const raw = floats(octets.subarray(at, at + 4 * column.rows), column.rows);
    at += 4 * column.rows;
    return valuesOf(raw, column);
  });
}

const blocks = new Map();

/** Columns of a block of the page. */
function columnsOf(id, columns) {
  if (!blocks.has(id)) {
    blocks.set(id, inflated(id).then((octets) => columnsIn(octets, columns)));
  }
  return blocks.get(id);
}

/** Times (s) of the rows of a run: evenly spaced, or 64-bit floats, which are a block of the page or bytes. */
async function timesOf({ rows, start, step, block }) {
  if (!block) return Float64Array.from({ length: rows }, (_, i) => start + i * step);
  const octets = typeof block === "string" ? await inflated(block) : block;
  const plain = new Uint8Array(8 * rows);
  for (let k = 0; k < 8; k++) for (let i = 0; i < rows; i++) plain[8 * i + k] = octets[k * rows + i];
  return new Float64Array(plain.buffer);
}
