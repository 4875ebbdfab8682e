/** Huffman codes of literals: RFC 8878, section 4.2. */
import { BackwardBits, damaged } from "./bits.js";
import { FseState, readFseTable } from "./fse.js";

export interface HuffmanTable {
  log: number;
  symbols: Uint8Array;
  bits: Uint8Array;
}

/** A table from the start of `bytes`, and how many bytes it takes. */
export function readHuffmanTable(bytes: Uint8Array): { table: HuffmanTable; size: number } {
  const head = bytes[0] ?? damaged("a tree is missing");
  const size = 1 + (head < 128 ? head : (head - 126) >> 1);
  if (size > bytes.length) damaged("a tree is cut off");
  const weights: number[] = [];
  if (head < 128) readWeights(bytes.subarray(1, size), weights);
  else for (let k = 0; k < head - 127; k++) weights.push((bytes[1 + (k >> 1)]! >> (k % 2 ? 0 : 4)) & 15);
  // The last weight is what is missing to a power of two.
  const sum = weights.reduce((a, w) => a + ((1 << w) >> 1), 0);
  const log = 32 - Math.clz32(sum);
  const rest = (1 << log) - sum;
  if (!sum || log > 11 || rest & (rest - 1)) damaged("a tree is wrong");
  weights.push(32 - Math.clz32(rest));
  const table = { log, symbols: new Uint8Array(1 << log), bits: new Uint8Array(1 << log) };
  let at = 0;
  for (let w = 1; w <= log; w++) {
    weights.forEach((weight, symbol) => {
      if (weight !== w) return;
      table.symbols.fill(symbol, at, at + (1 << (w - 1)));
      table.bits.fill(log + 1 - w, at, (at += 1 << (w - 1)));
    });
  }
  return { table, size };
}

/** Weights that are coded themselves, by two states in turn. */
function readWeights(bytes: Uint8Array, weights: number[]): void {
  const { table, size } = readFseTable(bytes, 6, 12);
  const bits = new BackwardBits(bytes.subarray(size));
  let [now, other] = [new FseState(table, bits), new FseState(table, bits)];
  while (weights.length < 255) {
    weights.push(now.symbol);
    if (bits.left < now.width) {
      weights.push(other.symbol);
      break;
    }
    now.advance();
    [now, other] = [other, now];
  }
  if (weights.length > 255 || bits.left < 0) damaged("a tree is wrong");
}

/** Decode a stream into the whole of `out`. */
export function readHuffman(bytes: Uint8Array, table: HuffmanTable, out: Uint8Array): void {
  const bits = new BackwardBits(bytes);
  for (let k = 0; k < out.length; k++) {
    const at = bits.peek(table.log);
    out[k] = table.symbols[at]!;
    bits.left -= table.bits[at]!;
  }
  if (bits.left) damaged("a literal stream has a wrong length");
}
