/** Compressed blocks: RFC 8878, section 3.1.1.3. */
import { BackwardBits, damaged } from "./bits.js";
import { FseState, type FseTable, fseTable, readFseTable } from "./fse.js";
import { type HuffmanTable, readHuffman, readHuffmanTable } from "./huffman.js";

const MAX_BLOCK = 2 ** 17;

/** How a kind of number is coded: literal lengths, offsets, match lengths. */
interface Kind {
  maxLog: number;
  maxSymbol: number;
  predefined: FseTable;
}

const ones = (n: number, value = 1): number[] => Array<number>(n).fill(value);

const LITERALS: Kind = {
  maxLog: 9,
  maxSymbol: 35,
  predefined: fseTable([4, 3, ...ones(11, 2), 1, 1, 1, ...ones(9, 2), 3, 2, ...ones(5), ...ones(4, -1)], 6),
};
const OFFSETS: Kind = {
  maxLog: 8,
  maxSymbol: 31,
  predefined: fseTable([...ones(6), 2, 2, 2, ...ones(15), ...ones(5, -1)], 5),
};
const MATCHES: Kind = {
  maxLog: 9,
  maxSymbol: 52,
  predefined: fseTable([1, 4, 3, ...ones(6, 2), ...ones(37), ...ones(7, -1)], 6),
};

const LITERAL_BITS = [...ones(16, 0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16];
const MATCH_BITS = [...ones(32, 0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16];

/** The least value of each code: that of the code before, and 2 to the power of its bits. */
function bases(bits: number[], first: number): number[] {
  let base = first;
  return bits.map((n) => (base += 2 ** n) - 2 ** n);
}

const LITERAL_BASES = bases(LITERAL_BITS, 0);
const MATCH_BASES = bases(MATCH_BITS, 3);

/** Decodes the blocks of one frame into a buffer of the frame's size. */
export class BlockDecoder {
  /** Bytes that are out. */
  at = 0;
  private huffman: HuffmanTable | undefined;
  private readonly tables: (FseTable | undefined)[] = [];
  private readonly offsets = [1, 4, 8];

  constructor(private readonly out: Uint8Array) {}

  /** Append bytes. */
  put(bytes: Uint8Array): void {
    this.need(bytes.length);
    this.out.set(bytes, this.at);
    this.at += bytes.length;
  }

  /** Append a byte many times. */
  fill(byte: number, size: number): void {
    this.need(size);
    this.out.fill(byte, this.at, (this.at += size));
  }

  /** Append what a compressed block holds. */
  compressed(block: Uint8Array): void {
    const start = this.at;
    const { literals, size } = this.literals(block);
    this.sequences(block.subarray(size), literals);
    if (this.at - start > MAX_BLOCK) damaged("a block is too large");
  }

  private need(size: number): void {
    if (this.at + size > this.out.length) damaged("there is more than the frame says");
  }

  private literals(block: Uint8Array): { literals: Uint8Array; size: number } {
    const head = block[0] ?? damaged("a block is empty");
    const [type, format] = [head & 3, (head >> 2) & 3];
    const isRaw = type < 2;
    const width = isRaw ? [5, 12, 5, 20][format]! : [10, 10, 14, 18][format]!;
    const skip = isRaw && !(format & 1) ? 3 : 4;
    const headSize = (skip + (isRaw ? width : 2 * width) + 7) >> 3;
    if (block.length < headSize) damaged("a block is cut off");
    let value = 0;
    for (let k = headSize - 1; k >= 0; k--) value = value * 256 + block[k]!;
    value = Math.floor(value / 2 ** skip);
    const regenerated = value % 2 ** width;
    if (regenerated > MAX_BLOCK) damaged("a block is too large");
    if (isRaw) {
      const size = headSize + (type ? 1 : regenerated);
      if (size > block.length) damaged("a block is cut off");
      if (type) return { literals: new Uint8Array(regenerated).fill(block[headSize]!), size };
      return { literals: block.subarray(headSize, size), size };
    }
    const size = headSize + Math.floor(value / 2 ** width);
    if (size > block.length) damaged("a block is cut off");
    let body = block.subarray(headSize, size);
    if (type === 2) {
      const read = readHuffmanTable(body);
      this.huffman = read.table;
      body = body.subarray(read.size);
    }
    const table = this.huffman ?? damaged("a tree is missing");
    const literals = new Uint8Array(regenerated);
    if (!format) readHuffman(body, table, literals);
    else {
      if (body.length < 6) damaged("a block is cut off");
      const part = (regenerated + 3) >> 2;
      if (3 * part > regenerated) damaged("literals are too few");
      let start = 6;
      for (let k = 0; k < 4; k++) {
        const end = k < 3 ? start + body[2 * k]! + 256 * body[2 * k + 1]! : body.length;
        if (end > body.length) damaged("a block is cut off");
        readHuffman(body.subarray(start, end), table, literals.subarray(k * part, k < 3 ? (k + 1) * part : regenerated));
        start = end;
      }
    }
    return { literals, size };
  }

  private sequences(body: Uint8Array, literals: Uint8Array): void {
    const [head, b1 = 0, b2 = 0] = body;
    let n = head ?? damaged("a block is cut off");
    let at = 1;
    if (n === 255) [n, at] = [b1 + 256 * b2 + 0x7f00, 3];
    else if (n > 127) [n, at] = [(n - 128) * 256 + b1, 2];
    if (!n) {
      if (at !== body.length) damaged("a block goes on after its end");
      this.put(literals);
      return;
    }
    const modes = body[at++] ?? damaged("a block is cut off");
    if (modes & 3) damaged("a block has a reserved mode");
    const tables = [LITERALS, OFFSETS, MATCHES].map((kind, k) => {
      const mode = (modes >> (6 - 2 * k)) & 3;
      if (mode === 0) this.tables[k] = kind.predefined;
      else if (mode === 1) {
        const symbol = body[at++] ?? damaged("a block is cut off");
        if (symbol > kind.maxSymbol) damaged("a code is wrong");
        this.tables[k] = { log: 0, symbols: Uint8Array.of(symbol), bits: Uint8Array.of(0), bases: Uint16Array.of(0) };
      } else if (mode === 2) {
        const read = readFseTable(body.subarray(at), kind.maxLog, kind.maxSymbol);
        this.tables[k] = read.table;
        at += read.size;
      }
      return this.tables[k] ?? damaged("a table is missing");
    });
    const bits = new BackwardBits(body.subarray(at));
    const [ofLiterals, ofOffsets, ofMatches] = tables.map((table) => new FseState(table, bits)) as [
      FseState, FseState, FseState,
    ];
    let used = 0;
    for (let k = 0; k < n; k++) {
      const offsetCode = ofOffsets.symbol;
      if (offsetCode > 24) damaged("an offset is too large"); // 16 MB, the largest file
      const [matchCode, literalCode] = [ofMatches.symbol, ofLiterals.symbol];
      const offset = 2 ** offsetCode + bits.read(offsetCode);
      const match = MATCH_BASES[matchCode]! + bits.read(MATCH_BITS[matchCode]!);
      const length = LITERAL_BASES[literalCode]! + bits.read(LITERAL_BITS[literalCode]!);
      if (bits.left < 0) damaged("sequences are cut off");
      if (used + length > literals.length) damaged("literals are too few");
      this.put(literals.subarray(used, (used += length)));
      this.copy(this.distance(offset, length), match);
      if (k < n - 1) {
        ofLiterals.advance();
        ofMatches.advance();
        ofOffsets.advance();
      }
    }
    if (bits.left) damaged("a block goes on after its sequences");
    this.put(literals.subarray(used));
  }

  /** How far back a match lies: one of the last three, or a new one. */
  private distance(value: number, literals: number): number {
    const { offsets } = this;
    const k = value > 3 ? 3 : value - 1 + (literals ? 0 : 1);
    const distance = value > 3 ? value - 3 : k < 3 ? offsets[k]! : offsets[0]! - 1;
    if (k) {
      offsets.splice(Math.min(k, 2), 1);
      offsets.unshift(distance);
    }
    return distance;
  }

  private copy(distance: number, size: number): void {
    const { out } = this;
    if (distance < 1 || distance > this.at) damaged("a match lies before the start");
    this.need(size);
    for (let k = 0; k < size; k++, this.at++) out[this.at] = out[this.at - distance]!;
  }
}
