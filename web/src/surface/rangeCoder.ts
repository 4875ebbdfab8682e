/** The adaptive binary range decoder: spec/cndhf.md, section 4.1. */
import { PayloadError, TruncatedError } from "../errors.js";

const LOOKAHEAD = 4; // bytes beyond the end that are taken as 0

/** The chance of a 0 times 2^16, and how many bits were seen. */
export class Context {
  constructor(
    public zero = 32768,
    public count = 0,
  ) {}
}

/** A context that starts from a chance of a 1 of `chance` 64ths. */
export const closing = (chance: number): Context => new Context(65536 - 1024 * chance, 8);

export const contexts = (n: number): Context[] => Array.from({ length: n }, () => new Context());

const SIGN = -(2 ** 31); // flipping the sign bits of two int32 compares them as unsigned

/** `range` and `code` are int32 that stand for unsigned numbers: those are fast from the first call on. */
export class RangeDecoder {
  private range = 0;
  private code = 0;
  private at = 0;
  private declare readonly bytes: Uint8Array;

  constructor(bytes: Uint8Array) {
    this.bytes = new Uint8Array(bytes.length + LOOKAHEAD);
    this.bytes.set(bytes);
    while (this.at < LOOKAHEAD) this.widen();
    this.range = -1;
  }

  bit(context: Context): number {
    const { zero, count } = context;
    const bit = this.split(Math.imul(this.range >>> 16, zero));
    context.zero = zero + ((((bit ? 0 : 65536) - zero) / (count + 2)) | 0);
    if (count < 62) context.count = count + 1;
    return bit;
  }

  /** `n` bits that are all equally likely, as a number below 2^31. */
  raw(n: number): number {
    let value = 0;
    while (n--) value = 2 * value + this.split(this.range >>> 1);
    return value;
  }

  /** 0 where the code lies below a bound, else 1. */
  private split(bound: number): number {
    const bit = (this.code ^ SIGN) < (bound ^ SIGN) ? 0 : 1;
    if (bit) {
      this.range = (this.range - bound) | 0;
      this.code = (this.code - bound) | 0;
    } else this.range = bound;
    while (this.range >>> 24 === 0) this.widen();
    return bit;
  }

  /** Check that the bytes end here, as an encoder ends them. */
  finish(): void {
    const { at, bytes } = this;
    let last = 0;
    for (let k = at - LOOKAHEAD; k < at; k++) last = last * 256 + bytes[k]!;
    const low = (last - this.code) >>> 0;
    const value = low === 0 || low + (this.range >>> 0) > 2 ** 32 ? 0 : Math.ceil(low / 2 ** 24) * 2 ** 24;
    if (last !== value || bytes.length !== at + (value ? 1 : 0)) {
      throw new PayloadError("the surface section goes on after its last symbol, or is damaged");
    }
  }

  private widen(): void {
    if (this.at === this.bytes.length) throw new TruncatedError("the surface section ends inside its symbols");
    this.range <<= 8;
    this.code = (this.code << 8) | this.bytes[this.at++]!;
  }
}
