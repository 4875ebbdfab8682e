/** Loop subdivision with sharp edges, and its limit: spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf } from "./manifold.js";

/** Faces and edges of a mesh. */
export interface Topology {
  nVertices: number;
  /** Three vertices per face. */
  faces: Int32Array;
  /** The edge from each corner of a face to the next. */
  faceEdges: Int32Array;
  /** Two vertices per edge. */
  ends: Int32Array;
  /** 1 for each sharp edge, boundary edges included. */
  sharp: Uint8Array;
}

/** A mesh with its vertices, three coordinates each, in the normalised frame. */
export interface Level {
  topology: Topology;
  vertices: Float64Array;
}

/** Of each vertex: how many edges it has, and how many of them are sharp. */
export interface Valences {
  edges: Int32Array;
  sharp: Int32Array;
}

export function valencesOf({ nVertices, ends, sharp }: Topology): Valences {
  const out = { edges: new Int32Array(nVertices), sharp: new Int32Array(nVertices) };
  for (let i = 0; i < ends.length; i++) {
    const v = ends[i]!;
    out.edges[v]!++;
    out.sharp[v]! += sharp[i >> 1]!;
  }
  return out;
}

/** The number of an edge as it leaves one of its ends: 2 e from the first, 2 e + 1 from the second. */
export const leaving = (ends: Int32Array, edge: number, v: number): number => 2 * edge + (ends[2 * edge] === v ? 0 : 1);

/** Loop's weight of each of n neighbours of a smooth vertex. */
const beta = (n: number): number => (5 / 8 - (3 / 8 + Math.cos((2 * Math.PI) / n) / 4) ** 2) / n;

/**
 * Sums of the neighbours of each vertex: of all, for a smooth one; of the two along sharp edges, for one on a crease;
 * of none, for a corner.
 */
function neighbourSums({ topology, vertices }: Level, valences: Valences): Float64Array {
  const { ends, sharp } = topology;
  const out = new Float64Array(vertices.length);
  for (let e = 0; e < sharp.length; e++) {
    const a = ends[2 * e]!;
    const b = ends[2 * e + 1]!;
    const atA = valences.sharp[a]!;
    const atB = valences.sharp[b]!;
    if (atA < 2 || (atA === 2 && sharp[e])) for (let k = 0; k < 3; k++) out[3 * a + k]! += vertices[3 * b + k]!;
    if (atB < 2 || (atB === 2 && sharp[e])) for (let k = 0; k < 3; k++) out[3 * b + k]! += vertices[3 * a + k]!;
  }
  return out;
}

/** One step of subdivision. Old vertices keep their numbers; the new one of edge e has the number V + e. */
export function subdivide(level: Level): Level {
  const { topology, vertices } = level;
  const { nVertices, faces, faceEdges, ends, sharp } = topology;
  const valences = valencesOf(topology);
  const sums = neighbourSums(level, valences);
  const out = new Float64Array(3 * (nVertices + sharp.length));
  for (let v = 0; v < nVertices; v++) {
    const n = valences.edges[v]!;
    const nSharp = valences.sharp[v]!;
    const each = nSharp < 2 ? beta(n) : nSharp === 2 ? 1 / 8 : 0;
    const own = 1 - each * (nSharp < 2 ? n : 2);
    for (let i = 3 * v; i < 3 * v + 3; i++) out[i] = own * vertices[i]! + each * sums[i]!;
  }
  for (let e = 0; e < sharp.length; e++) {
    const each = sharp[e] ? 1 / 2 : 3 / 8;
    const a = 3 * ends[2 * e]!;
    const b = 3 * ends[2 * e + 1]!;
    const at = 3 * (nVertices + e);
    for (let k = 0; k < 3; k++) out[at + k] = each * (vertices[a + k]! + vertices[b + k]!);
  }
  for (let h = 0; h < faces.length; h++) {
    const e = faceEdges[h]!;
    if (sharp[e]) continue;
    const across = 3 * faces[previousHalf(h)]!;
    const at = 3 * (nVertices + e);
    for (let k = 0; k < 3; k++) out[at + k]! += vertices[across + k]! / 8;
  }
  return { topology: divide(topology), vertices: out };
}

/**
 * Faces and edges after one step. Each face makes one at each corner and one in its middle. The halves of edge e are
 * 2 e, at its first end, and 2 e + 1; edge 2 E + h is the new one that cuts off corner h.
 */
function divide({ nVertices, faces, faceEdges, ends, sharp }: Topology): Topology {
  const nEdges = sharp.length;
  const n = faces.length;
  const out: Topology = {
    nVertices: nVertices + nEdges,
    faces: new Int32Array(4 * n),
    faceEdges: new Int32Array(4 * n),
    ends: new Int32Array(4 * nEdges + 2 * n),
    sharp: new Uint8Array(2 * nEdges + n),
  };
  for (let e = 0; e < nEdges; e++) {
    out.ends[4 * e] = ends[2 * e]!;
    out.ends[4 * e + 2] = ends[2 * e + 1]!;
    out.ends[4 * e + 1] = out.ends[4 * e + 3] = nVertices + e;
    out.sharp[2 * e] = out.sharp[2 * e + 1] = sharp[e]!;
  }
  for (let h = 0; h < n; h++) {
    const after = nextHalf(h);
    const before = previousHalf(h);
    const v = faces[h]!;
    const ahead = faceEdges[h]!;
    const behind = faceEdges[before]!;
    const x = nVertices + ahead;
    const y = nVertices + behind;
    const cut = 2 * nEdges + h;
    out.ends[2 * cut] = x;
    out.ends[2 * cut + 1] = y;
    // Corner k makes the face with v, x, y at k, k + 1, k + 2; the middle face has x at k.
    // What to add to a half-edge of the old face for that of a new one.
    const corner = 3 * h;
    const middle = 3 * (h - (h % 3)) + 9;
    out.faces[corner + h] = v;
    out.faces[corner + after] = x;
    out.faces[corner + before] = y;
    out.faceEdges[corner + h] = leaving(ends, ahead, v);
    out.faceEdges[corner + after] = cut;
    out.faceEdges[corner + before] = leaving(ends, behind, v);
    out.faces[middle + h] = x;
    out.faceEdges[middle + h] = 2 * nEdges + after;
  }
  return out;
}

/** The points of the limit surface that belong to the vertices, three coordinates each. */
export function limitPositions(level: Level, valences: Valences): Float64Array {
  const { topology, vertices } = level;
  const sums = neighbourSums(level, valences);
  const out = new Float64Array(vertices.length);
  for (let v = 0; v < topology.nVertices; v++) {
    const n = valences.edges[v]!;
    const nSharp = valences.sharp[v]!;
    const each = nSharp === 0 ? 1 / (n + 3 / (8 * beta(n))) : nSharp === 2 ? 1 / 6 : 0;
    const own = 1 - each * (nSharp ? 2 : n);
    for (let i = 3 * v; i < 3 * v + 3; i++) out[i] = own * vertices[i]! + each * sums[i]!;
  }
  if (valences.sharp.includes(1)) placeDarts(level, valences, out);
  return out;
}

/** The limit points of vertices with a single sharp edge: weights by place round the vertex from that edge. */
function placeDarts({ topology, vertices }: Level, valences: Valences, out: Float64Array): void {
  const { faces, faceEdges, ends, sharp } = topology;
  const spokes = new Map<number, Map<number, number[]>>(); // of each dart: edge -> the edges beside it
  for (let h = 0; h < faces.length; h++) {
    const v = faces[h]!;
    if (valences.sharp[v] !== 1) continue;
    let around = spokes.get(v);
    if (!around) spokes.set(v, (around = new Map()));
    const pair = [faceEdges[h]!, faceEdges[previousHalf(h)]!] as const;
    for (const [a, b] of [pair, [pair[1], pair[0]] as const]) {
      const beside = around.get(a);
      if (beside) beside.push(b);
      else around.set(a, [b]);
    }
  }
  const r = (5 - Math.sqrt(21)) / 2;
  for (const [v, around] of spokes) {
    const n = around.size;
    const weight = (i: number): number =>
      (8 / 3) * beta(n) * (1 - (r ** i + r ** (n - i)) / (1 + r ** n));
    let edge = [...around.keys()].find((e) => sharp[e])!;
    let before = -1;
    let sum = 1;
    const point = [0, 1, 2].map((k) => vertices[3 * v + k]!);
    for (let i = 0; i < n; i++) {
      const w = i ? weight(i) : 2 * beta(n) + (weight(1) + weight(n - 1)) / 4;
      const other = ends[2 * edge]! + ends[2 * edge + 1]! - v;
      for (let k = 0; k < 3; k++) point[k]! += w * vertices[3 * other + k]!;
      sum += w;
      const [a, b] = around.get(edge) as [number, number];
      [before, edge] = [edge, a === before ? b : a];
    }
    for (let k = 0; k < 3; k++) out[3 * v + k] = point[k]! / sum;
  }
}
