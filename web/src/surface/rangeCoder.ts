/** The adaptive binary range decoder: spec/cndhf.md, section 4.1. */
import { PayloadError, TruncatedError } from "../errors.js";

const LOOKAHEAD = 4; // bytes beyond the end that are taken as 0

/** What a bit was before: the chance of a 0 times 2^16, and how many bits were seen. */
export interface Context {
  zero: number;
  count: number;
}

export const context = (): Context => ({ zero: 32768, count: 0 });

/** A context that starts from a chance of a 1 of `chance` 64ths. */
export const closing = (chance: number): Context => ({ zero: 65536 - 1024 * chance, count: 8 });

export const contexts = (n: number): Context[] => Array.from({ length: n }, context);

export interface RangeDecoder {
  bit(context: Context): number;
  /** `n` bits that are all equally likely, as a number below 2^31. */
  raw(n: number): number;
  /** Check that the bytes end here, as an encoder ends them. */
  finish(): void;
}

/** Its variables are not an object's properties: until code is compiled those are slower, and a file ends about then. */
export function rangeDecoder(body: Uint8Array): RangeDecoder {
  const bytes = new Uint8Array(body.length + LOOKAHEAD);
  bytes.set(body);
  // Two int32 that stand for unsigned numbers: whole numbers are fast from the first call on.
  let range = -1;
  let code = 0;
  let at = 0;
  while (at < LOOKAHEAD) code = (code << 8) | bytes[at++]!;

  const widen = (): void => {
    do {
      if (at === bytes.length) throw new TruncatedError("the surface section ends inside its symbols");
      code = (code << 8) | bytes[at++]!;
      range <<= 8;
    } while (range >>> 24 === 0);
  };

  /** 0 where the code lies below a bound, else 1. */
  const split = (bound: number): number => {
    const bit = code >>> 0 < bound >>> 0 ? 0 : 1;
    if (bit) code = (code - bound) | 0;
    range = bit ? (range - bound) | 0 : bound;
    if (range >>> 24 === 0) widen();
    return bit;
  };

  return {
    bit(context) {
      const { zero, count } = context;
      if (count < 62) context.count = count + 1;
      const bit = split(Math.imul(range >>> 16, zero));
      context.zero = bit ? zero - ((zero / (count + 2)) | 0) : zero + (((65536 - zero) / (count + 2)) | 0);
      return bit;
    },

    raw(n) {
      let value = 0;
      while (n--) value = 2 * value + split(range >>> 1);
      return value;
    },

    finish() {
      let last = 0;
      for (let k = at - LOOKAHEAD; k < at; k++) last = last * 256 + bytes[k]!;
      const low = (last - code) >>> 0;
      const value = low === 0 || low + (range >>> 0) > 2 ** 32 ? 0 : Math.ceil(low / 2 ** 24) * 2 ** 24;
      if (last !== value || bytes.length !== at + (value ? 1 : 0)) {
        throw new PayloadError("the surface section goes on after its last symbol, or is damaged");
      }
    },
  };
}
