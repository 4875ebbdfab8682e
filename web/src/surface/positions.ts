/** Positions of control vertices: spec/cndhf.md, section 4.5. */
import { PayloadError } from "../errors.js";
import { type Edges, cornersOf, nextHalf, previousHalf } from "./manifold.js";
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
  const foretelling: number[][] = Array.from({ length: nVertices }, () => []); // half-edges x to y of these faces
  const queues = [new Queue(), new Queue(), new Queue()];
  const foretold = new SignedModel(); // C
  const others = new SignedModel(); // I
  const { corners, first: firstCorner } = cornersOf(faces, nVertices);
  let last = -1;

  const place = (v: number): void => {
    const by = foretelling[v]!;
    const m = by.length;
    const from = near[v]! < 0 ? last : near[v]!;
    for (let k = 0; k < 3; k++) {
      let guess = from < 0 ? 0 : at[3 * from + k]!;
      if (m) {
        let sum = 8 * m;
        for (const h of by) {
          const [x, y, z] = [faces[h]!, faces[nextHalf(h)]!, faces[previousHalf(h)]!];
          sum += (8 + eighths) * (at[3 * x + k]! + at[3 * y + k]!) - 2 * eighths * at[3 * z + k]!;
        }
        guess = Math.floor(sum / (16 * m));
      }
      const x = guess + (m ? foretold : others).decode(coder);
      if (Math.abs(x) > MAX_POSITION) {
        throw new PayloadError(`vertex ${v} of the control mesh lies beyond ${MAX_POSITION} grid units`);
      }
      at[3 * v + k] = x;
    }
    placed[v] = 1;
    last = v;
    for (let i = firstCorner[v]!; i < firstCorner[v + 1]!; i++) {
      const f = Math.floor(corners[i]! / 3);
      const full = --missing[f]! === 0;
      for (let h = 3 * f; h < 3 * f + 3; h++) {
        if (full) {
          const o = edges.opposite[h]!;
          const w = o < 0 ? v : faces[previousHalf(o)]!;
          if (placed[w]) continue;
          const count = foretelling[w]!.push(h);
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
        if (!placed[v] && Math.min(foretelling[v]!.length, 2) === count) return v;
      }
    }
    return -1;
  };

  for (let first = 0; first < nVertices; first++) {
    if (placed[first]) continue;
    place(first);
    for (let w = next(); w >= 0; w = next()) place(w);
  }
  return at;
}
