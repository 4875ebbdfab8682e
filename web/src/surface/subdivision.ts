/** Loop subdivision with sharp edges: spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf } from "./manifold.js";

/** Faces and edges of a mesh. Half-edge 3 f + k goes from corner k of face f to the next corner of that face. */
export interface Topology {
  /** Three vertices per face. */
  faces: Int32Array;
  /** The edge of each half-edge. */
  ofHalf: Int32Array;
  /** The other half-edge of each half-edge's edge, or -1 on a boundary. */
  opposite: Int32Array;
  /** 1 for each sharp edge, boundary edges included. */
  sharp: Uint8Array;
  /** Of each vertex, how many edges it has. */
  valences: Int32Array;
  /** Of each vertex, how many sharp edges it has. */
  sharpness: Int32Array;
}

/** Loop's weight of each of n neighbours of a smooth vertex. */
export const beta = (n: number): number => (5 / 8 - (3 / 8 + Math.cos((2 * Math.PI) / n) / 4) ** 2) / n;

/** The vertices after one step: the old ones, moved, then one per edge. Three coordinates each. */
export function nextVertices(mesh: Topology, vertices: Float64Array): Float64Array {
  const { faces, ofHalf, opposite, sharp, valences, sharpness } = mesh;
  const nOld = vertices.length;
  const out = new Float64Array(nOld + 3 * sharp.length); // of old vertices, first the sums of their neighbours
  for (let h = 0; h < faces.length; h++) {
    const o = opposite[h]!;
    if (o >= h) continue; // each edge once
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    const isSharp = sharp[ofHalf[h]!]!;
    const at = nOld + 3 * ofHalf[h]!;
    const c = 3 * faces[previousHalf(h)]!;
    const d = isSharp ? 0 : 3 * faces[previousHalf(o)]!;
    const toA = sharpness[a]! < 2 || (isSharp && sharpness[a] === 2);
    const toB = sharpness[b]! < 2 || (isSharp && sharpness[b] === 2);
    for (let k = 0; k < 3; k++) {
      const x = vertices[3 * a + k]!;
      const y = vertices[3 * b + k]!;
      out[at + k] = isSharp ? (x + y) / 2 : ((x + y) * 3 + vertices[c + k]! + vertices[d + k]!) / 8;
      if (toA) out[3 * a + k]! += y;
      if (toB) out[3 * b + k]! += x;
    }
  }
  for (let v = 0; v < valences.length; v++) {
    const n = valences[v]!;
    const nSharp = sharpness[v]!;
    const each = nSharp < 2 ? beta(n) : nSharp === 2 ? 1 / 8 : 0;
    const own = 1 - each * (nSharp < 2 ? n : 2);
    for (let i = 3 * v; i < 3 * v + 3; i++) out[i] = own * vertices[i]! + each * out[i]!;
  }
  return out;
}

/**
 * Faces and edges after one step. The vertex of edge e has the number V + e; its halves are the edges 2 e and 2 e + 1.
 * Face f makes the faces 4 f to 4 f + 2 at its corners, where these keep their places, and 4 f + 3 in its middle.
 */
export function divide({ faces, ofHalf, opposite, sharp, valences, sharpness }: Topology): Topology {
  const n = faces.length;
  const nOld = valences.length;
  const nEdges = sharp.length;
  const out: Topology = {
    faces: new Int32Array(4 * n),
    ofHalf: new Int32Array(4 * n),
    opposite: new Int32Array(4 * n).fill(-1),
    sharp: new Uint8Array(2 * nEdges + n),
    valences: new Int32Array(nOld + nEdges).fill(6),
    sharpness: new Int32Array(nOld + nEdges),
  };
  out.valences.set(valences);
  out.sharpness.set(sharpness);
  for (let h = 0; h < n; h++) {
    const after = nextHalf(h);
    const before = previousHalf(h);
    const middle = 3 * (h - (h % 3)) + 9; // what to add to h for a half-edge of the middle face
    // The face at the corner: from there along h, across to the edge behind, and back.
    const along = 4 * h;
    const across = 3 * h + after;
    const back = 3 * h + before;
    const e = ofHalf[h]!;
    const o = opposite[h]!;
    out.faces[along] = faces[h]!;
    out.faces[across] = out.faces[middle + h] = nOld + e;
    out.faces[back] = nOld + ofHalf[before]!;
    out.ofHalf[across] = out.ofHalf[middle + before] = 2 * nEdges + h;
    out.opposite[across] = middle + before;
    out.opposite[middle + before] = across;
    // The halves of the edge: from this corner, and to the next one.
    const there = 3 * after + h;
    const isFirst = o < h;
    const isSame = o >= 0 && faces[o] === faces[h];
    out.ofHalf[along] = 2 * e + (isFirst || isSame ? 0 : 1);
    out.ofHalf[there] = 2 * e + (isFirst || isSame ? 1 : 0);
    if (o >= 0) {
      const end = 3 * nextHalf(o) + o;
      out.opposite[along] = isSame ? 4 * o : end;
      out.opposite[there] = isSame ? end : 4 * o;
    }
    if (sharp[e] && isFirst) {
      out.sharp[2 * e] = out.sharp[2 * e + 1] = 1;
      out.sharpness[nOld + e] = 2;
      if (o < 0) out.valences[nOld + e] = 4;
    }
  }
  return out;
}
