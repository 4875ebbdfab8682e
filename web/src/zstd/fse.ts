/** Finite state entropy tables: RFC 8878, section 4.1. */
import { BackwardBits, damaged } from "./bits.js";

export interface FseTable {
  log: number;
  symbols: Uint8Array;
  bits: Uint8Array;
  bases: Uint16Array;
}

export function fseTable(counts: number[], log: number): FseTable {
  const size = 1 << log;
  const symbols = new Uint8Array(size);
  let high = size - 1;
  counts.forEach((count, symbol) => {
    if (count < 0) symbols[high--] = symbol;
  });
  const step = (size >> 1) + (size >> 3) + 3;
  let at = 0;
  counts.forEach((count, symbol) => {
    for (let k = 0; k < count; k++) {
      symbols[at] = symbol;
      do at = (at + step) & (size - 1);
      while (at > high);
    }
  });
  const next = counts.map((count) => Math.abs(count));
  const bits = new Uint8Array(size);
  const bases = new Uint16Array(size);
  for (let state = 0; state < size; state++) {
    const x = next[symbols[state]!]!++;
    bits[state] = log - (31 - Math.clz32(x));
    bases[state] = (x << bits[state]!) - size;
  }
  return { log, symbols, bits, bases };
}

/** A table from the start of `bytes`, and how many bytes it takes. */
export function readFseTable(bytes: Uint8Array, maxLog: number, maxSymbol: number): { table: FseTable; size: number } {
  let bit = 0;
  const peek = (n: number): number => {
    let value = 0;
    for (let k = 0; k < n; k++) value |= (((bytes[(bit + k) >> 3] ?? 0) >> ((bit + k) & 7)) & 1) << k;
    return value;
  };
  const log = peek(4) + 5;
  bit = 4;
  if (log > maxLog) damaged("a table is too large");
  let left = 1 << log;
  const counts: number[] = [];
  while (left > 0) {
    if (counts.length > maxSymbol || bit > 8 * bytes.length) damaged("a table is wrong");
    // Numbers from 0 to left + 1, the lower ones with a bit less.
    const n = 32 - Math.clz32(left + 1);
    const short = (1 << n) - 2 - left;
    let value = peek(n) & ((1 << (n - 1)) - 1);
    if (value < short) bit += n - 1;
    else {
      value = peek(n);
      if (value >= 1 << (n - 1)) value -= short;
      bit += n;
    }
    counts.push(value - 1);
    left -= Math.abs(value - 1);
    if (value === 1) {
      for (let repeat = 3; repeat === 3; ) {
        repeat = peek(2);
        bit += 2;
        for (let k = 0; k < repeat; k++) counts.push(0);
        if (counts.length > maxSymbol + 1) damaged("a table is wrong");
      }
    }
  }
  const size = (bit + 7) >> 3;
  if (left < 0 || counts.length > maxSymbol + 1 || size > bytes.length) damaged("a table is wrong");
  return { table: fseTable(counts, log), size };
}

/** A state that walks through a table. */
export class FseState {
  private state: number;

  constructor(
    private readonly table: FseTable,
    private readonly bits: BackwardBits,
  ) {
    this.state = bits.read(table.log);
  }

  get symbol(): number {
    return this.table.symbols[this.state]!;
  }

  /** How many bits `advance` takes. */
  get width(): number {
    return this.table.bits[this.state]!;
  }

  advance(): void {
    this.state = this.table.bases[this.state]! + this.bits.read(this.width);
  }
}
