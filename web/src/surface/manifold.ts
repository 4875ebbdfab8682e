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
  // Linked lists of half-edges by the greater of their vertices, then by the smaller one: so edges get into order.
  const byGreater = unset(nVertices);
  const bySmaller = unset(nVertices);
  const rest = unset(n);
  for (let h = n - 1; h >= 0; h--) {
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    if (a === b) fail(`face ${Math.floor(h / 3)} has a vertex twice`);
    after[h] = first[a]!;
    first[a] = h;
    const w = Math.max(a, b);
    rest[h] = byGreater[w]!;
    byGreater[w] = h;
  }
  for (let w = nVertices - 1; w >= 0; w--) {
    for (let h = byGreater[w]!; h >= 0; ) {
      const v = faces[h]! + faces[nextHalf(h)]! - w;
      const next = rest[h]!;
      rest[h] = bySmaller[v]!;
      bySmaller[v] = h;
      h = next;
    }
  }
  const ofHalf = new Int32Array(n);
  const opposite = unset(n);
  const ends = new Int32Array(2 * n);
  let size = 0;
  for (let v = 0; v < nVertices; v++) {
    let before = -1;
    let last = -1;
    for (let h = bySmaller[v]!; h >= 0; h = rest[h]!) {
      const w = faces[h]! + faces[nextHalf(h)]! - v;
      if (w !== last) {
        ends[size++] = v;
        ends[size++] = w;
      } else if (opposite[before]! >= 0) fail(`the edge of vertices ${v},${w} has more than two faces`);
      else {
        opposite[h] = before;
        opposite[before] = h;
      }
      ofHalf[h] = size / 2 - 1;
      before = h;
      last = w;
    }
  }
  const edges = { ends: ends.slice(0, size), ofHalf, opposite, first, after };
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
