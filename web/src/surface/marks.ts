/** Which edges are sharp: spec/cndhf.md, section 4.4. */
import { around, type Edges, nextHalf } from "./manifold.js";
import { Queue } from "./queue.js";
import { type Context, type RangeDecoder, context, contexts } from "./rangeCoder.js";

/** 1 for each sharp edge, boundary edges included. */
export function decodeMarks(coder: RangeDecoder, faces: Int32Array, nVertices: number, edges: Edges): Uint8Array {
  const { ends, ofHalf, opposite, first } = edges;
  const nEdges = ends.length / 2;
  const sharp = new Uint8Array(nEdges).fill(1);
  const todo = new Uint8Array(nEdges);
  for (let h = 0; h < ofHalf.length; h++) {
    if (opposite[h]! < 0) continue;
    sharp[ofHalf[h]!] = 0;
    todo[ofHalf[h]!] = 1;
  }
  if (!todo.includes(1) || !coder.bit(context())) return sharp;
  if (coder.bit(context())) return sharp.fill(1);
  const nSharp = new Int32Array(nVertices);
  const left = new Int32Array(nVertices);
  for (let i = 0; i < ends.length; i++) (todo[i >> 1] ? left : nSharp)[ends[i]!]!++;
  const lines = new Queue();
  const follows = contexts(15); // line
  const starts = contexts(9); // alone

  const mark = (edge: number, context: Context): void => {
    todo[edge] = 0;
    if (coder.bit(context)) {
      sharp[edge] = 1;
      for (let i = 2 * edge; i < 2 * edge + 2; i++) if (++nSharp[ends[i]!]! === 1) lines.push(ends[i]!);
    }
    left[ends[2 * edge]!]!--;
    left[ends[2 * edge + 1]!]!--;
  };

  const spokes: number[] = [];
  /** Mark the edges of v, which has one sharp edge: those opposite to it first, of two alike the lower number. */
  const follow = (v: number): void => {
    // A vertex on the boundary has two sharp edges, so the faces go all the way round v.
    let n = 0;
    let at = 0;
    let h = first[v]!;
    do {
      const edge = ofHalf[h]!;
      if (sharp[edge]) at = n;
      spokes[n++] = edge;
      h = around(v, h, faces, opposite);
    } while (h !== first[v]!);
    for (let k = n >> 1; k; k--) {
      const a = spokes[(at + k) % n]!;
      const b = spokes[(at + n - k) % n]!;
      followed(v, a < b ? a : b);
      followed(v, a < b ? b : a);
    }
  };

  const followed = (v: number, edge: number): void => {
    if (!todo[edge] || nSharp[v] !== 1) return;
    const w = ends[2 * edge]! + ends[2 * edge + 1]! - v;
    mark(edge, follows[3 * Math.min(left[v]!, 4) + Math.min(nSharp[w]!, 2)]!);
  };

  for (let h = 0; h < faces.length; h++) {
    for (let v; (v = lines.take()) >= 0; ) if (nSharp[v] === 1) follow(v);
    const edge = ofHalf[h]!;
    if (!todo[edge]) continue;
    const i = Math.min(nSharp[faces[h]!]!, 2);
    const j = Math.min(nSharp[faces[nextHalf(h)]!]!, 2);
    mark(edge, starts[3 * Math.min(i, j) + Math.max(i, j)]!);
  }
  return sharp;
}
