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
  const foretold = new SignedModel(); // C
  const others = new SignedModel(); // I
  const { opposite, corners, first } = edges;
  const sums = new Float64Array(3);
  let last = -1;

  const place = (v: number): void => {
    const m = foretelling[v]!;
    const from = near[v]! < 0 ? last : near[v]!;
    sums.fill(8 * m);
    // The faces that foretell v lie across the edges opposite to it.
    for (let i = first[v]!; m && i < first[v + 1]!; i++) {
      const h = opposite[nextHalf(corners[i]!)]!;
      if (h < 0 || missing[Math.floor(h / 3)]) continue;
      const x = 3 * faces[h]!;
      const y = 3 * faces[nextHalf(h)]!;
      const z = 3 * faces[previousHalf(h)]!;
      for (let k = 0; k < 3; k++) sums[k]! += (8 + eighths) * (at[x + k]! + at[y + k]!) - 2 * eighths * at[z + k]!;
    }
    for (let k = 0; k < 3; k++) {
      const guess = m ? Math.floor(sums[k]! / (16 * m)) : from < 0 ? 0 : at[3 * from + k]!;
      const x = guess + (m ? foretold : others).decode(coder);
      if (Math.abs(x) > MAX_POSITION) {
        throw new PayloadError(`vertex ${v} of the control mesh lies beyond ${MAX_POSITION} grid units`);
      }
      at[3 * v + k] = x;
    }
    placed[v] = 1;
    last = v;
    for (let i = first[v]!; i < first[v + 1]!; i++) {
      const f = Math.floor(corners[i]! / 3);
      const full = --missing[f]! === 0;
      for (let h = 3 * f; h < 3 * f + 3; h++) {
        if (full) {
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
      for (let v = queues[count]!.take(); v !== undefined; v = queues[count]!.take()) {
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
