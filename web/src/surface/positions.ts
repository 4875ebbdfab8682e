/** Positions of control vertices: spec/cndhf.md, section 4.5. */
import { PayloadError } from "../errors.js";
import { type Edges, nextHalf, previousHalf, unset } from "./manifold.js";
import { SignedModel } from "./models.js";
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
  const told = new SignedModel();
  const untold = new SignedModel();
  const same = contexts(48);
  const { opposite, first, after } = edges;
  let last = -1;

  const corners: number[] = [];
  const place = (v: number): void => {
    const from = near[v]! < 0 ? last : near[v]!;
    // The faces that foretell v lie across the edges opposite to it.
    corners.length = 0;
    for (let corner = first[v]!; corner >= 0; corner = after[corner]!) {
      const h = opposite[nextHalf(corner)]!;
      if (h >= 0 && !missing[(h / 3) | 0]) corners.push(faces[h]!, faces[nextHalf(h)]!, faces[previousHalf(h)]!);
    }
    const m = corners.length / 3;
    for (let k = 0; k < 3; k++) {
      let guess = 0;
      for (let i = 0; i < corners.length; i++) guess += at[3 * corners[i]! + k]! * (i % 3 < 2 ? 8 + eighths : -2 * eighths);
      guess = m ? Math.round(guess / (16 * m)) : (at[3 * from + k] ?? 0);
      let x: number | undefined;
      if (repeats) {
        const found = [...new Set(corners.map((w) => at[3 * w + k]!))];
        x = found
          .sort((p, q) => Math.abs(p - guess) - Math.abs(q - guess) || p - q)
          .find((_, i) => coder.bit(same[16 * k + 4 * Math.min(found.length, 3) + Math.min(i, 3)]!));
      }
      x ??= guess + (m ? told : untold).read(coder);
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
        if (isFull) {
          const w = faces[previousHalf(opposite[h]!)] ?? v;
          if (!placed[w]) queues[2 - ++foretelling[w]!]?.push(w);
        } else {
          const w = faces[h]!;
          if (!placed[w] && near[w]! < 0) {
            near[w] = v;
            queues[2]!.push(w);
          }
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
