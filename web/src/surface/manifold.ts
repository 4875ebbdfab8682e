/** Edges of a triangle mesh. Half-edge h = 3 f + k goes from corner k of face f to the next corner of that face. */
import { PayloadError } from "../errors.js";

export interface Edges {
  /** Two vertices per edge, the smaller first; edges in lexicographic order. */
  ends: Int32Array;
  /** The edge of each half-edge. */
  ofHalf: Int32Array;
  /** The other half-edge of each half-edge's edge, or -1 on a boundary. */
  opposite: Int32Array;
  /** The least half-edge that starts at each vertex, and after each half-edge the next one that starts there, or -1. */
  first: Int32Array;
  after: Int32Array;
}

export const nextHalf = (h: number): number => (h % 3 === 2 ? h - 2 : h + 1);
export const previousHalf = (h: number): number => (h % 3 ? h - 1 : h + 2);

/** So many numbers that are still to be found. */
export const unset = (size: number): Int32Array => new Int32Array(size).fill(-1);

/** The edge at vertex v after that of half-edge h: the half-edges of both are in the face across h. -1 at a boundary. */
export function around(v: number, h: number, faces: Int32Array, opposite: Int32Array): number {
  const o = opposite[h]!;
  return o < 0 ? o : faces[o] === v ? previousHalf(o) : nextHalf(o);
}

/** The edges of faces. Throws PayloadError where they are not a two-manifold, with boundary or without. */
export function edgesOf(faces: Int32Array, nVertices: number): Edges {
  const n = faces.length;
  const first = unset(nVertices);
  const after = unset(n);
  // Half-edges in order of their edges. So many numbers fit into a double: a file's vertices make 2^33 pairs at most.
  const order = new Float64Array(n);
  for (let h = n - 1; h >= 0; h--) {
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    if (a === b) fail(`face ${Math.floor(h / 3)} has a vertex twice`);
    after[h] = first[a]!;
    first[a] = h;
    const low = Math.min(a, b);
    const pair = (low * (2 * nVertices - low - 1)) / 2 + Math.max(a, b);
    order[h] = pair * n + h;
  }
  order.sort();
  const ofHalf = new Int32Array(n);
  const opposite = unset(n);
  const ends: number[] = [];
  let before = -1;
  let last = -1;
  for (let i = 0; i < n; i++) {
    const h = order[i]! % n;
    const pair = (order[i]! - h) / n;
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    if (pair !== last) ends.push(Math.min(a, b), Math.max(a, b));
    else if (opposite[before]! >= 0) fail(`the edge of vertices ${a},${b} has more than two faces`);
    else {
      opposite[h] = before;
      opposite[before] = h;
    }
    ofHalf[h] = ends.length / 2 - 1;
    before = h;
    last = pair;
  }
  const edges = { ends: Int32Array.from(ends), ofHalf, opposite, first, after };
  checkFans(faces, edges);
  return edges;
}

/** Refuse two faces of the same vertices, and vertices whose faces are not one fan. */
function checkFans(faces: Int32Array, { opposite, first, after }: Edges): void {
  for (let h = 0; h < faces.length; h += 3) {
    const f = Math.floor(opposite[h]! / 3);
    if (f >= 0 && f === Math.floor(opposite[h + 1]! / 3) && f === Math.floor(opposite[h + 2]! / 3)) {
      fail(`faces ${h / 3},${f} have the same vertices`);
    }
  }
  for (let v = 0; v < first.length; v++) {
    const start = first[v]!;
    // The faces on the way round v from the first one: ahead to where it comes back or to a boundary, then back.
    let rest = 0;
    for (let h = after[start]!; h >= 0; h = after[h]!) rest++;
    let h = around(v, start, faces, opposite);
    for (; h >= 0 && h !== start; h = around(v, h, faces, opposite)) rest--;
    if (h < 0) for (h = previousHalf(start); (h = around(v, h, faces, opposite)) >= 0; ) rest--;
    if (rest) fail(`the faces at vertex ${v} are more than one fan`);
  }
}

function fail(why: string): never {
  throw new PayloadError(`the control mesh is not a two-manifold: ${why}`);
}
