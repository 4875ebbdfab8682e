/** Bits of zstd: forwards for tables, backwards for everything else. */
/** What is wrong with a frame. */
export class ZstdError extends Error {}

export function damaged(why: string): never {
  throw new ZstdError(`the weights do not decompress (zstd: ${why})`);
}

/** Reads from the last bit, marked by a 1 above it, to the first. */
export class BackwardBits {
  /** Bits left; negative when more were read than there are, which count as 0. */
  left: number;

  constructor(private readonly bytes: Uint8Array) {
    const last = bytes[bytes.length - 1];
    if (!last) damaged("a bit stream has no end mark");
    this.left = 8 * bytes.length - 1 - Math.clz32(last) + 24;
  }

  /** The next `n` bits, at most 24. */
  read(n: number): number {
    const value = this.peek(n);
    this.left -= n;
    return value;
  }

  peek(n: number): number {
    let value = 0;
    const low = this.left - n;
    for (let at = low >> 3, shift = -(low & 7); shift < n; at++, shift += 8) {
      const byte = this.bytes[at] ?? 0;
      value |= shift < 0 ? byte >> -shift : byte << shift;
    }
    return value & (2 ** n - 1);
  }
}
