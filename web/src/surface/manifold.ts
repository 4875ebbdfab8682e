/** Edges of a triangle mesh. Half-edge h = 3 f + k goes from corner k of face f to the next corner of that face. */
import { PayloadError } from "../errors.js";

export interface Edges {
  /** Two vertices per edge, the smaller first; edges in lexicographic order. */
  ends: Int32Array;
  /** The edge of each half-edge. */
  ofHalf: Int32Array;
  /** The other half-edge of each half-edge's edge, or -1 on a boundary. */
  opposite: Int32Array;
  /** The half-edges that start at each vertex v, in order: corners[first[v]] to corners[first[v + 1] - 1]. */
  corners: Int32Array;
  first: Int32Array;
}

export const nextHalf = (h: number): number => (h % 3 === 2 ? h - 2 : h + 1);
export const previousHalf = (h: number): number => (h % 3 ? h - 1 : h + 2);

/** Items in stable order of their keys, which are below n. */
function sortedBy(keys: Int32Array, n: number, items: Int32Array): Int32Array {
  const at = new Int32Array(n + 1);
  for (let i = 0; i < items.length; i++) at[keys[items[i]!]! + 1]!++;
  for (let k = 0; k < n; k++) at[k + 1]! += at[k]!;
  const out = new Int32Array(items.length);
  for (let i = 0; i < items.length; i++) out[at[keys[items[i]!]!]!++] = items[i]!;
  return out;
}

function numbers(n: number): Int32Array {
  const out = new Int32Array(n);
  for (let i = 0; i < n; i++) out[i] = i;
  return out;
}

/** The edges of faces. Throws PayloadError where they are not a two-manifold, with boundary or without. */
export function edgesOf(faces: Int32Array, nVertices: number): Edges {
  const n = faces.length;
  const low = new Int32Array(n);
  const high = new Int32Array(n);
  for (let h = 0; h < n; h++) {
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    if (a === b) fail(`face ${Math.floor(h / 3)} has a vertex twice`);
    low[h] = Math.min(a, b);
    high[h] = Math.max(a, b);
  }
  const byHigh = sortedBy(high, nVertices, numbers(n));
  const order = sortedBy(low, nVertices, byHigh);
  const ends: number[] = [];
  const ofHalf = new Int32Array(n);
  const opposite = new Int32Array(n).fill(-1);
  for (let i = 0; i < n; i++) {
    const h = order[i]!;
    const before = order[i - 1];
    if (before === undefined || low[h] !== low[before] || high[h] !== high[before]) {
      ends.push(low[h]!, high[h]!);
    } else if (opposite[before]! >= 0) {
      fail(`the edge of vertices ${low[h]},${high[h]} has more than two faces`);
    } else {
      opposite[h] = before;
      opposite[before] = h;
    }
    ofHalf[h] = ends.length / 2 - 1;
  }
  const corners = sortedBy(faces, nVertices, numbers(n));
  const first = new Int32Array(nVertices + 1).fill(n);
  for (let i = n - 1; i >= 0; i--) first[faces[corners[i]!]!] = i;
  const edges = { ends: new Int32Array(ends), ofHalf, opposite, corners, first };
  checkFans(faces, edges);
  return edges;
}

/** Refuse two faces of the same vertices, and vertices whose faces are not one fan. */
function checkFans(faces: Int32Array, { opposite, corners, first }: Edges): void {
  for (let h = 0; h < faces.length; h += 3) {
    const f = Math.floor(opposite[h]! / 3);
    if (f >= 0 && f === Math.floor(opposite[h + 1]! / 3) && f === Math.floor(opposite[h + 2]! / 3)) {
      fail(`faces ${h / 3},${f} have the same vertices`);
    }
  }
  for (let v = 0; v < first.length - 1; v++) {
    const start = corners[first[v]!]!;
    // The faces on the way round v from the first one: ahead to where it comes back or to a boundary, then back.
    let met = 1;
    let h = start;
    for (let o = opposite[h]!; o >= 0; o = opposite[h]!) {
      h = faces[o] === v ? previousHalf(o) : nextHalf(o);
      if (h === start) break;
      met++;
    }
    if (opposite[h]! < 0) {
      h = previousHalf(start);
      for (let o = opposite[h]!; o >= 0; o = opposite[h]!, met++) h = faces[o] === v ? previousHalf(o) : nextHalf(o);
    }
    if (met < first[v + 1]! - first[v]!) fail(`the faces at vertex ${v} are more than one fan`);
  }
}

function fail(why: string): never {
  throw new PayloadError(`the control mesh is not a two-manifold: ${why}`);
}
