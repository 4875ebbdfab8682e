/** Codec 1 of weights, one zstd frame without its magic number: spec/cndhf.md, section 3.1. */
import { c } from "../constants.js";
import { damaged, ZstdError } from "./bits.js";
import { BlockDecoder } from "./block.js";

/**
 * Flat symbols of tensors with these sizes; `wide` ones have two bytes per symbol. Throws a ZstdError for a damaged
 * frame, and a RangeError for a symbol that is too large: this file stands alone, so that loading it is one request.
 */
export function decodeZstd(body: Uint8Array, sizes: number[], wide: boolean[]): Int16Array[] {
  const nLow = sizes.reduce((a, b) => a + b);
  const raw = decompress(body, sizes.reduce((sum, n, k) => sum + (wide[k] ? n : 0), nLow));
  let [low, high] = [0, nLow];
  return sizes.map((n, k) =>
    new Int16Array(n).map(() => {
      const u = raw[low++]! + (wide[k] ? 256 * raw[high++]! : 0);
      const s = u % 2 ? -(u + 1) / 2 : u / 2;
      if (s < -c.MAX_SYMBOL) throw new RangeError(`a weight symbol is below -${c.MAX_SYMBOL}`);
      return s;
    }),
  );
}

export { ZstdError };

/** The content of a frame, which must have this size. */
function decompress(body: Uint8Array, size: number): Uint8Array {
  const head = body[0];
  const sizeBytes = head === 0x20 ? 1 : head === 0x60 ? 2 : head === 0xa0 ? 4 : 0;
  if (!sizeBytes) {
    throw new ZstdError(`the frame descriptor of the weights is ${head ?? "missing"}; 32, 96, 160 are allowed`);
  }
  let at = 1 + sizeBytes;
  if (at > body.length) throw new ZstdError("the weights are not a zstd frame");
  let declared = sizeBytes === 2 ? 256 : 0;
  for (let k = 0; k < sizeBytes; k++) declared += body[1 + k]! * 256 ** k;
  if (declared !== size) {
    throw new ZstdError(`the weights frame declares ${declared} bytes; the DHF records need ${size} bytes`);
  }
  const out = new Uint8Array(size);
  const decoder = new BlockDecoder(out);
  for (let last = false; !last; ) {
    if (at + 3 > body.length) damaged("it is cut off");
    const header = body[at]! + 256 * body[at + 1]! + 65536 * body[at + 2]!;
    at += 3;
    last = !!(header & 1);
    const [type, length] = [(header >> 1) & 3, header >> 3];
    const end = at + (type === 1 ? 1 : length);
    if (end > body.length || type === 3 || length > 2 ** 17) damaged("a block is wrong");
    if (type === 0) decoder.put(body.subarray(at, end));
    else if (type === 1) decoder.fill(body[at]!, length);
    else decoder.compressed(body.subarray(at, end));
    at = end;
  }
  if (decoder.at !== size) damaged(`it holds ${decoder.at} bytes`);
  if (at !== body.length) damaged("there are bytes after the frame");
  return out;
}
