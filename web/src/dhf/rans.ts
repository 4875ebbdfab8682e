/** Codec 2 of weights: rANS with a rounded Gaussian per tensor: spec/cndhf.md, section 3.2. */
import { c } from "../constants.js";
import { view } from "../container.js";
import { LimitError, PayloadError } from "../errors.js";

const SCALE_CODES = 60;
const ESCAPE = 63;
const TOTAL_BITS = 14;
const LOW = 2 ** 23;
// Most symbols of a section: so many, and so many more per byte of it.
const FREE_SYMBOLS = 2 ** 15;
const SYMBOLS_PER_BYTE = 4;

// p of the spec's rows 0 to 23. Their q are the p of two rows before, but for the first two; rows 24 to 27 have rows 18
// to 21's p as p and q.
const P = [
  5628, 58611, 307285, 991630, 2270549, 4078822, 6171993, 8272320, 10175896, 11780768, 13066109, 14058751, 14805841,
  15357953, 15760736, 16051906, 16261035, 16410554, 16517109, 16592872, 16646655, 16684790, 16711808, 16730939,
];

interface Table {
  frequencies: Int32Array;
  starts: Int32Array;
  /** The bucket of each number below 2^14. */
  lookup: Uint8Array;
}

function makeTable(code: number): Table {
  const wide = code >= 24;
  let p = P[wide ? 18 + (code % 4) : code]!;
  const q = wide ? p : (P[code - 2] ?? [2, 205][code]!);
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
    throw new LimitError(
      `the weights have ${body.length} bytes for ${total} symbols, which are too many`,
    );
  }
  let at = sizes.length + 4;
  if (body.length < at) throw new PayloadError("the weights end inside their scale codes");
  const codes = body.subarray(0, sizes.length);
  const largest = codes.reduce((most, code) => Math.max(most, code & 127), 0);
  if (largest >= SCALE_CODES) {
    throw new PayloadError(
      `a scale code of the weights is ${largest}; 0 to ${SCALE_CODES - 1} are allowed`,
    );
  }
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
