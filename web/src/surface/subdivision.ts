/** Loop subdivision with sharp edges, and its limit: spec/cndhf.md, section 6.2. */
import { around, nextHalf, previousHalf, unset } from "./manifold.js";

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
const beta = (n: number): number => (5 / 8 - (3 / 8 + Math.cos((2 * Math.PI) / n) / 4) ** 2) / n;

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

/** The limit points of vertices; `next` are those after one step. A step moves a vertex by a part of its way to the limit. */
export function limitPoints(mesh: Topology, vertices: Float64Array, next: Float64Array): Float64Array {
  const { faces, ofHalf, opposite, sharp, valences, sharpness } = mesh;
  const out = new Float64Array(vertices.length);
  for (let v = 0; v < valences.length; v++) {
    const part = sharpness[v]! < 2 ? valences[v]! * beta(valences[v]!) + 3 / 8 : 3 / 4;
    for (let i = 3 * v; i < 3 * v + 3; i++) out[i] = vertices[i]! + (next[i]! - vertices[i]!) / part;
  }
  /** A dart, whose sharp edge is that of half-edge h: its neighbours have weights by their places round it. */
  const setDart = (v: number, h: number): void => {
    const n = valences[v]!;
    const r = (5 - Math.sqrt(21)) / 2;
    const weight = (i: number): number => (8 / 3) * beta(n) * (1 - (r ** i + r ** (n - i)) / (1 + r ** n));
    let sum = 1;
    for (let k = 0; k < 3; k++) out[3 * v + k] = vertices[3 * v + k]!;
    for (let i = 0; i < n; i++) {
      const share = i ? weight(i) : 2 * beta(n) + (weight(1) + weight(n - 1)) / 4;
      const neighbour = faces[h]! + faces[nextHalf(h)]! - v;
      sum += share;
      for (let k = 0; k < 3; k++) out[3 * v + k]! += share * vertices[3 * neighbour + k]!;
      h = around(v, h, faces, opposite);
    }
    for (let k = 0; k < 3; k++) out[3 * v + k]! /= sum;
  };
  for (let h = 0; h < faces.length; h++) {
    if (opposite[h]! > h || !sharp[ofHalf[h]!]) continue;
    for (const v of [faces[h]!, faces[nextHalf(h)]!]) if (sharpness[v] === 1) setDart(v, h);
  }
  return out;
}

/** The limit points of the vertices after one step, `next`, where `points` are those of the vertices before. */
export function nextLimitPoints(mesh: Topology, next: Float64Array, points: Float64Array): Float64Array {
  const { faces, ofHalf, opposite, sharp } = mesh;
  const nOld = points.length;
  const out = new Float64Array(next.length);
  out.set(points);
  for (let h = 0; h < faces.length; h++) {
    const o = opposite[h]!;
    if (o >= h) continue;
    const isSharp = sharp[ofHalf[h]!];
    const at = nOld + 3 * ofHalf[h]!;
    const a = 3 * faces[h]!;
    const b = 3 * faces[nextHalf(h)]!;
    // The neighbours of a new vertex are the ends of its edge, and the new vertices of the edges of its two faces.
    const p = nOld + 3 * ofHalf[nextHalf(h)]!;
    const q = nOld + 3 * ofHalf[previousHalf(h)]!;
    const r = isSharp ? 0 : nOld + 3 * ofHalf[nextHalf(o)]!;
    const s = isSharp ? 0 : nOld + 3 * ofHalf[previousHalf(o)]!;
    for (let k = 0; k < 3; k++) {
      const line = 4 * next[at + k]! + next[a + k]! + next[b + k]!;
      const beside = 2 * next[at + k]! + next[p + k]! + next[q + k]! + next[r + k]! + next[s + k]!;
      out[at + k] = isSharp ? line / 6 : (line + beside) / 12;
    }
  }
  return out;
}

/**
 * What belongs to the corners of faces after one step: `own` of the corners before, `ofEdge` of the half-edges in whose
 * middle the new corners are. Face f makes the faces 4 f to 4 f + 2 at its corners, where these keep their places, and
 * 4 f + 3 in its middle.
 */
export function divideCorners(own: Int32Array, ofEdge: Int32Array): Int32Array {
  const out = new Int32Array(4 * own.length);
  for (let h = 0; h < own.length; h++) {
    const after = nextHalf(h);
    out[4 * h] = own[h]!;
    out[3 * h + after] = out[3 * after + h] = out[3 * (h - (h % 3)) + 9 + h] = ofEdge[h]!;
  }
  return out;
}

/** Faces and edges after one step. The vertex of edge e has the number V + e; its halves are the edges 2 e and 2 e + 1. */
export function divide({ faces, ofHalf, opposite, sharp, valences, sharpness }: Topology): Topology {
  const n = faces.length;
  const nOld = valences.length;
  const nEdges = sharp.length;
  const out: Topology = {
    faces: divideCorners(faces, ofHalf.map((e) => nOld + e)),
    ofHalf: new Int32Array(4 * n),
    opposite: unset(4 * n),
    sharp: new Uint8Array(2 * nEdges + n),
    valences: new Int32Array(nOld + nEdges).fill(6),
    sharpness: new Int32Array(nOld + nEdges),
  };
  out.valences.set(valences);
  out.sharpness.set(sharpness);
  for (let h = 0; h < n; h++) {
    const after = nextHalf(h);
    // The side between the face at the corner and that in the middle.
    const across = 3 * h + after;
    const inner = 3 * (h - (h % 3)) + 9 + previousHalf(h);
    out.ofHalf[across] = out.ofHalf[inner] = 2 * nEdges + h;
    out.opposite[across] = inner;
    out.opposite[inner] = across;
    // The halves of the edge: from this corner, and to the next one.
    const there = 3 * after + h;
    const e = ofHalf[h]!;
    const o = opposite[h]!;
    const isFirst = o < h;
    const isSame = o >= 0 && faces[o] === faces[h];
    const half = isFirst || isSame ? 0 : 1;
    out.ofHalf[4 * h] = 2 * e + half;
    out.ofHalf[there] = 2 * e + 1 - half;
    if (o >= 0) {
      const end = 3 * nextHalf(o) + o;
      out.opposite[4 * h] = isSame ? 4 * o : end;
      out.opposite[there] = isSame ? end : 4 * o;
    }
    if (sharp[e] && isFirst) {
      out.sharp[2 * e] = out.sharp[2 * e + 1] = 1;
      out.sharpness[nOld + e] = 2;
    }
  }
  return out;
}
