/** Edges of a triangle mesh. Half-edge h = 3 f + k goes from corner k of face f to the next corner of that face. */
import { PayloadError } from "../errors.js";

export interface Edges {
  /** Two vertices per edge, the smaller first; edges in lexicographic order. */
  ends: Int32Array;
  /** The edge of each half-edge. */
  ofHalf: Int32Array;
  /** The other half-edge of each half-edge's edge, or -1 on a boundary. */
  opposite: Int32Array;
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

/** The corners (3 f + k) of the faces of each vertex, those of vertex v from first[v] to first[v + 1], in order. */
export interface Corners {
  corners: Int32Array;
  first: Int32Array;
}

export function cornersOf(faces: Int32Array, nVertices: number): Corners {
  const first = new Int32Array(nVertices + 1);
  for (const v of faces) first[v + 1]!++;
  for (let v = 0; v < nVertices; v++) first[v + 1]! += first[v]!;
  return { corners: sortedBy(faces, nVertices, numbers(faces.length)), first };
}

const numbers = (n: number): Int32Array => new Int32Array(n).map((_, i) => i);

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
  checkFans(faces, nVertices, opposite);
  return { ends: Int32Array.from(ends), ofHalf, opposite };
}

/** Refuse two faces of the same vertices, and vertices whose faces are not one fan. */
function checkFans(faces: Int32Array, nVertices: number, opposite: Int32Array): void {
  const n = faces.length;
  const label = numbers(n); // union-find over the corners of each vertex
  const find = (h: number): number => {
    while (label[h] !== h) h = label[h] = label[label[h]!]!;
    return h;
  };
  let fans = n;
  const unite = (a: number, b: number): void => {
    a = find(a);
    b = find(b);
    if (a !== b) fans--;
    label[a] = b;
  };
  for (let h = 0; h < n; h++) {
    const o = opposite[h]!;
    if (o < 0) continue;
    if (h % 3 === 0) {
      const [f, g] = [Math.floor(o / 3), opposite[h + 1]!];
      if (Math.floor(g / 3) === f && g >= 0 && Math.floor(opposite[h + 2]! / 3) === f) {
        fail(`faces ${h / 3},${f} have the same vertices`);
      }
    }
    if (o < h) continue;
    const aligned = faces[o] === faces[h];
    unite(h, aligned ? o : nextHalf(o));
    unite(nextHalf(h), aligned ? nextHalf(o) : o);
  }
  if (fans > nVertices) fail("the faces at a vertex are more than one fan");
}

function fail(why: string): never {
  throw new PayloadError(`the control mesh is not a two-manifold: ${why}`);
}
