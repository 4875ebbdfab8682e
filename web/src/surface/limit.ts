/** The limit surface of a subdivided mesh: points and normals, spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf } from "./manifold.js";
import { beta, type Topology } from "./subdivision.js";

/**
 * A mesh on the limit surface. Across a sharp edge that bends, so a vertex has a point per *sector*: the corners around
 * it from one sharp edge to the next, or all. The first sector of vertex v has the number v.
 */
export interface LimitMesh {
  /** Three coordinates per sector. */
  points: Float64Array;
  /** Unit normals, three coordinates per sector. */
  normals: Float32Array;
  /** Three sectors per face. */
  index: Uint32Array;
  /** The vertices of the last sectors: those that are not their vertex's first. */
  further: number[];
}

/** A sector whose normal has to wait for the points around it: by the angles of its triangles. */
interface Waiting {
  sector: number;
  /** The neighbours, anticlockwise, from the first to the last of the sector's triangles. */
  ring: number[];
}

/**
 * The limit of a mesh with these vertices. With `isDivided` the vertices are those after one step more, and so is the
 * result: what lies around them is known without making that topology.
 */
export function limitMesh(mesh: Topology, vertices: Float64Array, isDivided: boolean): LimitMesh {
  const { faces, ofHalf, opposite, sharp } = mesh;
  const nOld = mesh.valences.length;
  const nVertices = vertices.length / 3;
  const further: number[] = [];
  const most = 3 * (nVertices + (isDivided ? 2 : 1) * faces.length);
  const points = new Float64Array(most);
  const normals = new Float32Array(most);
  const waiting: Waiting[] = [];
  const ofCorner = new Uint32Array(faces.length);
  const ofEdgeVertex = new Uint32Array(isDivided ? faces.length : 0); // per half-edge: the sector in its face

  /** A further sector of a vertex. */
  const furtherSector = (vertex: number): number => {
    const sector = nVertices + further.push(vertex) - 1;
    points.copyWithin(3 * sector, 3 * vertex, 3 * vertex + 3);
    return sector;
  };

  const u = new Float64Array(3);
  const w = new Float64Array(3);
  /** Set the normal of a sector from its tangents u and w, or say that they have none. */
  const setNormal = (sector: number, isTurned: boolean): boolean => {
    const x = u[1]! * w[2]! - u[2]! * w[1]!;
    const y = u[2]! * w[0]! - u[0]! * w[2]!;
    const z = u[0]! * w[1]! - u[1]! * w[0]!;
    const length = Math.sqrt(x * x + y * y + z * z) * (isTurned ? -1 : 1);
    normals[3 * sector] = x / length;
    normals[3 * sector + 1] = y / length;
    normals[3 * sector + 2] = z / length;
    return length !== 0;
  };

  /** The normal of a sector from one sharp edge to another one of a crease (Hoppe et al. 1994). */
  const setCrease = (sector: number, vertex: number, ring: number[]): void => {
    const n = ring.length - 1;
    const table = (creases[n] ??= creaseWeights(n));
    for (let k = 0; k < 3; k++) {
      const own = vertices[3 * vertex + k]!;
      let across = 0;
      for (let i = 0; i <= n; i++) across += table[i]! * (vertices[3 * ring[i]! + k]! - own);
      u[k] = vertices[3 * ring[0]! + k]! - vertices[3 * ring[n]! + k]!; // the tangent along the crease
      w[k] = across;
    }
    if (!setNormal(sector, false)) waiting.push({ sector, ring });
  };

  /** The neighbours of an edge's vertex on one side, with the ends. */
  const sideOf = (h: number): number[] => [
    faces[nextHalf(h)]!, nOld + ofHalf[nextHalf(h)]!, nOld + ofHalf[previousHalf(h)]!, faces[h]!,
  ];

  // The vertices on edges. They have six neighbours, or four on a boundary: the ends, and the middles around.
  for (let h = 0; isDivided && h < faces.length; h++) {
    const o = opposite[h]!;
    if (o >= h) continue; // each edge once
    const v = nOld + ofHalf[h]!;
    const isSharp = sharp[ofHalf[h]!]!;
    const isTurned = !isSharp && faces[o] === faces[h];
    const a = 3 * faces[h]!;
    const b = 3 * faces[nextHalf(h)]!;
    const c = 3 * (nOld + ofHalf[nextHalf(h)]!);
    const d = 3 * (nOld + ofHalf[previousHalf(h)]!);
    const e = isSharp ? 0 : 3 * (nOld + ofHalf[nextHalf(o)]!);
    const f = isSharp ? 0 : 3 * (nOld + ofHalf[previousHalf(o)]!);
    for (let k = 0; k < 3; k++) {
      const own = vertices[3 * v + k]!;
      const p = vertices[b + k]!;
      const q = vertices[c + k]!;
      const r = vertices[d + k]!;
      const s = vertices[a + k]!;
      if (isSharp) {
        points[3 * v + k] = (4 * own + p + s) / 6;
        continue;
      }
      const t = vertices[e + k]!;
      const x = vertices[f + k]!;
      points[3 * v + k] = (6 * own + p + q + r + s + t + x) / 12;
      // Loop's tangents: sums by the cosines and sines of sixths of a turn; of the second, the root of 3 / 4 is left out.
      u[k] = p - s + (q - r - t + x) / 2;
      w[k] = q + r - t - x;
    }
    ofEdgeVertex[h] = v;
    if (o >= 0) ofEdgeVertex[o] = isSharp || isTurned ? furtherSector(v) : v;
    if (!isSharp && !isTurned) {
      if (!setNormal(v, false)) waiting.push({ sector: v, ring: [...sideOf(h), ...sideOf(o).slice(1)] });
      continue;
    }
    for (const g of o >= 0 ? [h, o] : [h]) {
      if (isSharp) setCrease(ofEdgeVertex[g]!, v, sideOf(g));
      else waiting.push({ sector: ofEdgeVertex[g]!, ring: sideOf(g) });
    }
  }

  const starts = new Int32Array(nOld);
  for (let h = 0; h < faces.length; h++) starts[faces[h]!] = h;
  // The fan of faces around a vertex: its neighbours, and the corners between them.
  const spokes: number[] = [];
  const isSharpSpoke: boolean[] = [];
  const corners: number[] = [];
  const turned: boolean[] = []; // whether the face has the other orientation than the walk
  let size = 0; // corners of the fan
  let n = 0; // spokes
  /** The neighbours from spoke i over `count` corners, anticlockwise. */
  const around = (i: number, count: number): number[] => {
    const ring = Array.from({ length: count + 1 }, (_, j) => spokes[(i + j) % n]!);
    return turned[i % size] ? ring.reverse() : ring;
  };
  for (let v = 0; v < nOld; v++) {
    // Turn round v to the boundary, or all the way. From there back, or from the last sharp edge that was met.
    const start = starts[v]!;
    let from = start;
    let h = start;
    for (let o = opposite[h]!; ; o = opposite[h]!) {
      if (sharp[ofHalf[h]!]) from = h;
      if (o < 0) break;
      h = faces[o] === v ? previousHalf(o) : nextHalf(o);
      if (h === start) break;
    }
    h = from;
    size = 0;
    let isClosed = true;
    let nSharp = 0;
    for (;;) {
      const isAhead = faces[h] === v;
      spokes[size] = isDivided ? nOld + ofHalf[h]! : faces[isAhead ? nextHalf(h) : h]!;
      nSharp += sharp[ofHalf[h]!]!;
      isSharpSpoke[size] = !!sharp[ofHalf[h]!];
      corners[size] = isAhead ? h : nextHalf(h);
      turned[size++] = !isAhead;
      const across = isAhead ? previousHalf(h) : nextHalf(h);
      h = opposite[across]!;
      if (h === from) break;
      if (h >= 0) continue;
      isClosed = false;
      nSharp++;
      isSharpSpoke[size] = true;
      spokes[size] = isDivided ? nOld + ofHalf[across]! : faces[isAhead ? across : nextHalf(across)]!;
      break;
    }
    n = isClosed ? size : size + 1;
    let seam = 1; // where the orientation changes first; `size` where it does not
    while (seam < size && turned[seam] === turned[0]) seam++;
    if (nSharp === 2) {
      const other = isSharpSpoke.indexOf(true, 1);
      for (let k = 0; k < 3; k++) {
        const ends = vertices[3 * spokes[0]! + k]! + vertices[3 * spokes[other]! + k]!;
        points[3 * v + k] = (4 * vertices[3 * v + k]! + ends) / 6;
      }
    } else if (nSharp > 2) {
      for (let k = 0; k < 3; k++) points[3 * v + k] = vertices[3 * v + k]!;
    } else {
      const table = fanWeights(n);
      const column = nSharp ? 3 : 2; // darts have weights of their own
      u.fill(0);
      w.fill(0);
      let sum = 1;
      for (let k = 0; k < 3; k++) points[3 * v + k] = vertices[3 * v + k]!;
      for (let i = 0; i < n; i++) {
        const share = table[4 * i + column]!;
        const at = 3 * spokes[i]!;
        sum += share;
        for (let k = 0; k < 3; k++) {
          const x = vertices[at + k]!;
          u[k]! += table[4 * i]! * x;
          w[k]! += table[4 * i + 1]! * x;
          points[3 * v + k]! += share * x;
        }
      }
      for (let k = 0; k < 3; k++) points[3 * v + k]! /= sum;
      if (seam === size) {
        for (let i = 0; i < size; i++) ofCorner[corners[i]!] = v;
        if (!setNormal(v, turned[0]!)) waiting.push({ sector: v, ring: around(0, n) });
        continue;
      }
    }
    // Where only orientation changes, the first sector starts there.
    const shift = nSharp ? 0 : seam;
    for (let i = 0; i < size; ) {
      let end = i + 1;
      const at = (j: number): number => (j + shift) % size;
      while (end < size && !isSharpSpoke[at(end)] && turned[at(end)] === turned[at(i)]) end++;
      const sector = i ? furtherSector(v) : v;
      for (let j = i; j < end; j++) ofCorner[corners[at(j)]!] = sector;
      const ring = around(i + shift, end - i);
      const isWhole = isSharpSpoke[at(i)] && isSharpSpoke[isClosed ? at(end) : end];
      if (nSharp === 2 && isWhole) setCrease(sector, v, ring);
      else waiting.push({ sector, ring });
      i = end;
    }
  }
  for (const { sector, ring } of waiting) normals.set(normalByAngles(points, sector, ring), 3 * sector);
  return {
    points: points.subarray(0, 3 * (nVertices + further.length)),
    normals: normals.slice(0, 3 * (nVertices + further.length)),
    index: isDivided ? dividedIndex(ofCorner, ofEdgeVertex) : ofCorner,
    further,
  };
}

/** The sectors of the corners of divided faces, in the order of `divide`. */
function dividedIndex(ofCorner: Uint32Array, ofEdgeVertex: Uint32Array): Uint32Array {
  const out = new Uint32Array(4 * ofCorner.length);
  for (let h = 0; h < ofCorner.length; h++) {
    const x = ofEdgeVertex[h]!;
    const middle = 3 * (h - (h % 3)) + 9;
    out[4 * h] = ofCorner[h]!;
    out[3 * h + nextHalf(h)] = out[middle + h] = x;
    out[3 * nextHalf(h) + h] = x;
  }
  return out;
}

const tables: number[][] = [];
const creases: number[][] = [];

/** Weights of n + 1 neighbours in the tangent across a crease; of a single face, both arms count alike. */
function creaseWeights(n: number): number[] {
  const x = Math.PI / n;
  const end = n === 1 ? 1 : -Math.cos(x) / Math.tan(x / 2) / (1 + 2 * Math.cos(x));
  return Array.from({ length: n + 1 }, (_, i) => (i % n ? Math.sin(i * x) : end));
}

/**
 * Weights of n neighbours in a fan, four each: in Loop's two tangents, the cosine and the sine of the angle; in the limit
 * point of a smooth vertex, and of a dart whose sharp edge leads to the first of them, for weight 1 of the vertex itself.
 */
function fanWeights(n: number): number[] {
  let table = tables[n];
  if (table) return table;
  table = [];
  const b = (8 / 3) * beta(n);
  const r = (5 - Math.sqrt(21)) / 2;
  const dart = (i: number): number => b * (1 - (r ** i + r ** (n - i)) / (1 + r ** n));
  for (let i = 0; i < n; i++) {
    const angle = (2 * Math.PI * i) / n;
    table.push(Math.cos(angle), Math.sin(angle), b, i ? dart(i) : (3 / 4) * b + (dart(1) + dart(n - 1)) / 4);
  }
  if (n < 64) tables[n] = table;
  return table;
}

/** The unit normals of the triangles between limit points, by their angles. */
function normalByAngles(points: Float64Array, centre: number, ring: number[]): number[] {
  const sum = [0, 0, 0];
  let a: number[] = [];
  for (const v of ring) {
    const b = unit([0, 1, 2].map((k) => points[3 * v + k]! - points[3 * centre + k]!));
    if (a.length) {
      const n = unit(cross(a, b));
      const angle = 2 * Math.atan2(
        Math.hypot(a[0]! - b[0]!, a[1]! - b[1]!, a[2]! - b[2]!), Math.hypot(a[0]! + b[0]!, a[1]! + b[1]!, a[2]! + b[2]!),
      );
      for (let k = 0; k < 3; k++) sum[k]! += angle * n[k]!;
    }
    a = b;
  }
  return unit(sum);
}

const cross = (a: number[], b: number[]): number[] => [
  a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!,
];

/** A vector at length one; zero stays zero. */
function unit([x, y, z]: number[]): number[] {
  const length = Math.hypot(x!, y!, z!) || 1;
  return [x! / length, y! / length, z! / length];
}
