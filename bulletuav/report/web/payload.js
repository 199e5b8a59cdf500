// Reader of the page's payload; report/payload.py is the writer.

const NO_VALUE = 65535;
const TYPES = { f4: Float32Array, u4: Uint32Array, u2: Uint16Array, u1: Uint8Array };

/** A quantized time series: `rows` values for each of its parts. */
class Series {
  constructor(changes, low, step, rows) {
    this.low = low;
    this.step = step;
    this.rows = rows;
    this.codes = changes;
    // Stored values are differences between rows, modulo 2^16; sum them up in place.
    for (let part = 0; part < low.length; part += 1) {
      for (let k = part * rows + 1; k < (part + 1) * rows; k += 1) changes[k] += changes[k - 1];
    }
  }

  /** Return one value; NaN if it is missing. */
  at(row, part) {
    const code = this.codes[part * this.rows + row];
    return code === NO_VALUE ? NaN : this.low[part] + code * this.step[part];
  }

  /** Interpolate all values between two rows into `out`. */
  between(row, share, out) {
    const { codes, low, step, rows } = this;
    const next = row + 1 < rows ? 1 : 0;
    for (let part = 0, k = row; part < low.length; part += 1, k += rows) {
      out[part] = low[part] + (codes[k] + share * (codes[k + next] - codes[k])) * step[part];
    }
  }
}

/** The payload: metadata in `about`, and arrays by name. */
export class Payload {
  constructor(block) {
    const length = new DataView(block).getUint32(0, true);
    this.about = JSON.parse(new TextDecoder().decode(new Uint8Array(block, 4, length)));
    this.block = block;
    this.start = 4 + length;
    this.grows = false; // true for live payloads
    this.known = new Map();
  }

  array(name) {
    const { at, length, kind } = this.about.arrays[name];
    return new TYPES[kind](this.block, this.start + at, length);
  }

  has(name) {
    return `${name} codes` in this.about.arrays;
  }

  series(name) {
    if (!this.known.has(name)) {
      const [codes, low, step] = ["codes", "low", "step"].map((part) =>
        this.array(`${name} ${part}`),
      );
      this.known.set(name, new Series(codes, low, step, this.about.rows));
    }
    return this.known.get(name);
  }
}

/** Decode the text of `Payload.text` in Python. */
export async function readPayload(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let k = 0; k < letters.length; k += 1) bytes[k] = letters.charCodeAt(k);
  const whole = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Payload(await new Response(whole).arrayBuffer());
}
