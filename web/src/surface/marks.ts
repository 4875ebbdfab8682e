/** Which edges are sharp: spec/cndhf.md, section 4.4. */
import type { Edges } from "./manifold.js";
import { nextHalf, previousHalf } from "./manifold.js";
import { Queue } from "./queue.js";
import { type RangeDecoder, Context, contexts } from "./rangeCoder.js";

/** 1 for each sharp edge, boundary edges included. */
export function decodeMarks(coder: RangeDecoder, faces: Int32Array, nVertices: number, edges: Edges): Uint8Array {
  const { ends, ofHalf, opposite, corners, first } = edges;
  const sharp = new Uint8Array(ends.length / 2).fill(1);
  for (let h = 0; h < ofHalf.length; h++) if (opposite[h]! >= 0) sharp[ofHalf[h]!] = 0;
  const interior = sharp.map((s) => 1 - s);
  if (!interior.includes(1) || !coder.bit(new Context())) return sharp;
  if (coder.bit(new Context())) return sharp.fill(1);
  const todo = interior;
  const nSharp = new Int32Array(nVertices);
  const left = new Int32Array(nVertices);
  ends.forEach((v, i) => (todo[i >> 1] ? left : nSharp)[v]!++);
  const lines = new Queue();
  const follows = [0, 1, 2, 3, 4].map(() => contexts(3)); // L
  const starts = [0, 1, 2].map(() => contexts(3)); // E

  const mark = (edge: number, context: Context): void => {
    todo[edge] = 0;
    const bit = coder.bit(context);
    sharp[edge] = bit;
    for (const v of [ends[2 * edge]!, ends[2 * edge + 1]!]) {
      left[v]!--;
      if (bit && ++nSharp[v]! === 1) lines.push(v);
    }
  };

  /** The edges of v by their distance in its fan from the sharp one, farthest first; equals by number. */
  const oppositeFirst = (v: number): number[] => {
    const beside = new Map<number, number[]>();
    const put = (a: number, b: number): void => {
      const found = beside.get(a);
      if (found) found.push(b);
      else beside.set(a, [b]);
    };
    for (let i = first[v]!; i < first[v + 1]!; i++) {
      const [a, b] = [ofHalf[corners[i]!]!, ofHalf[previousHalf(corners[i]!)]!];
      put(a, b);
      put(b, a);
    }
    let ring = [...beside.keys()].filter((edge) => sharp[edge]);
    const seen = new Set(ring);
    const rings: number[][] = [];
    while (ring.length) {
      rings.push(ring.sort((a, b) => a - b));
      const farther = new Set(ring.flatMap((edge) => beside.get(edge)!).filter((edge) => !seen.has(edge)));
      ring = [...farther];
      for (const edge of ring) seen.add(edge);
    }
    return rings.reverse().flat();
  };

  for (let h = 0; h < faces.length; h++) {
    for (let v = lines.take(); v !== undefined; v = lines.take()) {
      if (nSharp[v] !== 1) continue;
      for (const edge of oppositeFirst(v)) {
        if (!todo[edge] || nSharp[v] !== 1) continue;
        const w = ends[2 * edge]! + ends[2 * edge + 1]! - v;
        mark(edge, follows[Math.min(left[v]!, 4)]![Math.min(nSharp[w]!, 2)]!);
      }
    }
    const edge = ofHalf[h]!;
    if (!todo[edge]) continue;
    const [i, j] = [Math.min(nSharp[faces[h]!]!, 2), Math.min(nSharp[faces[nextHalf(h)]!]!, 2)];
    mark(edge, starts[Math.min(i, j)]![Math.max(i, j)]!);
  }
  return sharp;
}
