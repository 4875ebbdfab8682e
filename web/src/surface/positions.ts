/** Positions of control vertices: spec/cndhf.md, section 4.5. */
import { PayloadError } from "../errors.js";
import { type Edges, nextHalf, previousHalf } from "./manifold.js";
import { SignedModel } from "./models.js";
import { Queue } from "./queue.js";
import type { RangeDecoder } from "./rangeCoder.js";

const MAX_POSITION = 2 ** 18;

/** Three grid coordinates per vertex. */
export function decodePositions(
  coder: RangeDecoder,
  faces: Int32Array,
  nVertices: number,
  edges: Edges,
  eighths: number,
): Int32Array {
  const at = new Int32Array(3 * nVertices);
  const placed = new Uint8Array(nVertices);
  const missing = new Uint8Array(faces.length / 3).fill(3);
  const near = new Int32Array(nVertices).fill(-1);
  const foretelling = new Int32Array(nVertices); // how many faces foretell a vertex that is not placed
  const queues = [new Queue(), new Queue(), new Queue()];
  const told = new SignedModel();
  const untold = new SignedModel();
  const { opposite, first, after } = edges;
  let last = -1;

  const place = (v: number): void => {
    const m = foretelling[v]!;
    const from = near[v]! < 0 ? last : near[v]!;
    for (let k = 0; k < 3; k++) {
      let guess = 8 * m;
      // The faces that foretell v lie across the edges opposite to it.
      for (let corner = m ? first[v]! : -1; corner >= 0; corner = after[corner]!) {
        const h = opposite[nextHalf(corner)]!;
        if (h < 0 || missing[(h / 3) | 0]) continue;
        const ends = at[3 * faces[h]! + k]! + at[3 * faces[nextHalf(h)]! + k]!;
        guess += (8 + eighths) * ends - 2 * eighths * at[3 * faces[previousHalf(h)]! + k]!;
      }
      const x = m ? Math.floor(guess / (16 * m)) + told.read(coder) : (at[3 * from + k] ?? 0) + untold.read(coder);
      if (Math.abs(x) > MAX_POSITION) {
        throw new PayloadError(`vertex ${v} of the control mesh lies beyond ${MAX_POSITION} grid units`);
      }
      at[3 * v + k] = x;
    }
    placed[v] = 1;
    last = v;
    for (let corner = first[v]!; corner >= 0; corner = after[corner]!) {
      const start = corner - (corner % 3);
      const isFull = --missing[start / 3]! === 0;
      for (let h = start; h < start + 3; h++) {
        if (isFull) {
          const o = opposite[h]!;
          const w = o < 0 ? v : faces[previousHalf(o)]!;
          if (placed[w]) continue;
          const count = ++foretelling[w]!;
          if (count < 3) queues[count]!.push(w);
        } else {
          const w = faces[h]!;
          if (placed[w] || near[w]! >= 0) continue;
          near[w] = v;
          queues[0]!.push(w);
        }
      }
    }
  };

  const next = (): number => {
    for (let count = 2; count >= 0; count--) {
      for (let v = queues[count]!.take(); v >= 0; v = queues[count]!.take()) {
        if (!placed[v] && Math.min(foretelling[v]!, 2) === count) return v;
      }
    }
    return -1;
  };

  for (let v = 0; v < nVertices; v++) {
    if (placed[v]) continue;
    place(v);
    for (let w = next(); w >= 0; w = next()) place(w);
  }
  return at;
}
