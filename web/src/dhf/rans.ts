/** Codec 2 of weights: rANS with a rounded Gaussian per tensor: spec/cndhf.md, section 3.2. */
import { c } from "../constants.js";
import { inRange, view } from "../container.js";
import { LimitError, PayloadError } from "../errors.js";

const SCALE_CODES = 60;
const ESCAPE = 63;
const TOTAL_BITS = 14;
const LOW = 2 ** 23;
// Most symbols of a section: so many, and so many more per byte of it.
const FREE_SYMBOLS = 2 ** 15;
const SYMBOLS_PER_BYTE = 4;

/**
 * The spec's ratio of a row; its change is that of two rows before. They are whole numbers near to these powers, none of
 * which is within 0.01 of the middle between two, so that no rounding of `exp` can matter.
 */
const ratio = (row: number): number => Math.round(2 ** 24 * Math.exp(-(2 ** (3 - row / 2))));

interface Table {
  frequencies: Int32Array;
  starts: Int32Array;
  /** The bucket of each number below 2^14. */
  lookup: Uint8Array;
}

function makeTable(code: number): Table {
  const wide = code >= 24;
  let p = ratio(wide ? 18 + (code % 4) : code);
  const q = wide ? p : ratio(code - 2);
  let value = 2 ** 24;
  const weights = [wide ? value : value / 2];
  for (let k = 1; k < ESCAPE; k++) {
    value = Math.floor((value * p) / 2 ** 24);
    p = Math.floor((p * q) / 2 ** 24);
    weights.push(value);
  }
  weights.push(0);
  const sum = weights.reduce((a, b) => a + b);
  const frequencies = Int32Array.from(weights, (w) => 1 + Math.floor((w * (2 ** TOTAL_BITS - 64)) / sum));
  frequencies[0]! += 2 ** TOTAL_BITS - frequencies.reduce((a, b) => a + b);
  const starts = new Int32Array(64);
  const lookup = new Uint8Array(2 ** TOTAL_BITS);
  for (let k = 0, at = 0; k < 64; k++) {
    starts[k] = at;
    lookup.fill(k, at, (at += frequencies[k]!));
  }
  return { frequencies, starts, lookup };
}

/** Flat symbols of tensors with these sizes. Throws LimitError or PayloadError. */
export function decodeRans(body: Uint8Array, sizes: number[]): Int16Array[] {
  const total = sizes.reduce((a, b) => a + b);
  if (total > FREE_SYMBOLS + SYMBOLS_PER_BYTE * body.length) {
    throw new LimitError(`the weights have ${body.length} bytes: too few for ${total} symbols`);
  }
  let at = sizes.length + 4;
  if (body.length < at) throw new PayloadError("the weights end inside their scale codes");
  const codes = body.subarray(0, sizes.length);
  const largest = codes.reduce((most, code) => Math.max(most, code & 127), 0);
  inRange("a scale code of the weights", largest, 0, SCALE_CODES - 1, PayloadError);
  let state = view(body).getUint32(at - 4, true);
  if (state < LOW || state >= 256 * LOW) {
    throw new PayloadError("the weights start with an impossible state");
  }
  const refill = (): void => {
    while (state < LOW) {
      if (at === body.length) throw new PayloadError("the weights end inside their symbols");
      state = (state << 8) | body[at++]!;
    }
  };
  const uniform = (bits: number): number => {
    const value = state & ((1 << bits) - 1);
    state >>= bits;
    refill();
    return value;
  };
  const tables: Table[] = [];
  const out = sizes.map((size, i) => {
    const code = codes[i]! & 127;
    const rising = codes[i]! > 127;
    const low = Math.max(0, (code >> 2) - 5);
    const { frequencies, starts, lookup } = (tables[code] ??= makeTable(code));
    const symbols = new Int16Array(size);
    let last = 0;
    for (let k = 0; k < size; k++) {
      const m = state & (2 ** TOTAL_BITS - 1);
      const bucket = lookup[m]!;
      state = frequencies[bucket]! * (state >> TOTAL_BITS) + m - starts[bucket]!;
      refill();
      let value = bucket;
      if (bucket === ESCAPE) value = uniform(8) * 256 + uniform(8);
      else if (low) value = (bucket << low) + uniform(low);
      if (rising) value = last += value;
      else if (value && uniform(1)) value = -value;
      if (Math.abs(value) > c.MAX_SYMBOL) throw new PayloadError(`a weight symbol is beyond ${c.MAX_SYMBOL}`);
      symbols[k] = value;
    }
    return symbols;
  });
  if (state !== LOW || at !== body.length) {
    throw new PayloadError("the weights go on after their last symbol, or are damaged");
  }
  return out;
}
