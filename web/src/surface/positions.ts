/** Positions of control vertices: spec/cndhf.md, section 4.5. */
import { PayloadError } from "../errors.js";
import { type Edges, nextHalf, previousHalf, unset } from "./manifold.js";
import { signedModel } from "./models.js";
import { Queue } from "./queue.js";
import { contexts, type RangeDecoder } from "./rangeCoder.js";

const MAX_POSITION = 2 ** 18;

/** Three grid coordinates per vertex. */
export function decodePositions(
  coder: RangeDecoder,
  faces: Int32Array,
  nVertices: number,
  edges: Edges,
  eighths: number,
  repeats: number,
): Int32Array {
  const at = new Int32Array(3 * nVertices);
  const placed = new Uint8Array(nVertices);
  const missing = new Uint8Array(faces.length / 3).fill(3);
  const near = unset(nVertices);
  const foretelling = new Int32Array(nVertices); // how many faces foretell a vertex that is not placed
  const queues = Array.from({ length: 3 }, () => new Queue()); // vertices that 2, 1 and 0 faces foretell
  const told = signedModel(coder);
  const untold = signedModel(coder);
  const same = contexts(48);
  const { opposite, first, after } = edges;
  let last = -1;

  const place = (v: number): void => {
    const from = 3 * (near[v]! < 0 ? last : near[v]!);
    // The faces that foretell v lie across the edges opposite to it.
    const corners: number[] = [];
    const sums = [0, 0, 0];
    let m = 0;
    for (let corner = first[v]!; corner >= 0; corner = after[corner]!) {
      const h = opposite[nextHalf(corner)]!;
      if (h < 0 || missing[(h / 3) | 0]) continue;
      m += 16;
      const a = 3 * faces[h]!;
      const b = 3 * faces[nextHalf(h)]!;
      const c = 3 * faces[previousHalf(h)]!;
      for (let k = 0; k < 3; k++) sums[k]! += (8 + eighths) * (at[a + k]! + at[b + k]!) - 2 * eighths * at[c + k]!;
      if (repeats) corners.push(a, b, c);
    }
    for (let k = 0; k < 3; k++) {
      const guess = m ? Math.round(sums[k]! / m) : (at[from + k] ?? 0);
      let x: number | undefined;
      if (repeats) {
        const found = [...new Set(corners.map((w) => at[w + k]!))];
        x = found
          .sort((p, q) => Math.abs(p - guess) - Math.abs(q - guess) || p - q)
          .find((_, i) => coder.bit(same[16 * k + 4 * Math.min(found.length, 3) + Math.min(i, 3)]!));
      }
      x ??= guess + (m ? told : untold)();
      if (Math.abs(x) > MAX_POSITION) {
        throw new PayloadError(`a vertex of the control mesh lies beyond ${MAX_POSITION} grid units`);
      }
      at[3 * v + k] = x;
    }
    placed[v] = 1;
    last = v;
    for (let corner = first[v]!; corner >= 0; corner = after[corner]!) {
      const start = corner - (corner % 3);
      const isFull = --missing[start / 3]! === 0;
      for (let h = start; h < start + 3; h++) {
        const o = opposite[h]!;
        const w = isFull && o >= 0 ? faces[previousHalf(o)]! : faces[h]!;
        if (placed[w]) continue;
        if (isFull) queues[2 - ++foretelling[w]!]?.push(w);
        else if (near[w]! < 0) {
          near[w] = v;
          queues[2]!.push(w);
        }
      }
    }
  };

  const next = (): number => {
    for (const queue of queues) for (let v; (v = queue.take()) >= 0; ) if (!placed[v]) return v;
    return -1;
  };

  for (let v = 0; v < nVertices; v++) {
    for (let w = placed[v] ? -1 : v; w >= 0; w = next()) place(w);
  }
  return at;
}
