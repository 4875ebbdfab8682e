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

/**
 * The limit of a mesh with these vertices. With `isDivided` the vertices are those after one step more, and so is the
 * result: what lies around them is known without making that topology.
 */
export function limitMesh(mesh: Topology, vertices: Float64Array, isDivided: boolean): LimitMesh {
  const { faces, ofHalf, opposite, sharp, sharpness } = mesh;
  const nOld = sharpness.length;
  const nVertices = vertices.length / 3;
  const further: number[] = [];
  const most = 3 * (nVertices + (isDivided ? 2 : 1) * faces.length);
  const points = new Float64Array(most);
  const normals = new Float32Array(most);
  const ofCorner = new Uint32Array(faces.length);
  const ofEdgeVertex = new Uint32Array(isDivided ? faces.length : 0); // per half-edge: the sector in its face
  // Sectors whose normals have to wait for the points around them. For each: its number, how many triangles it has,
  // negative where they are turned, and the neighbours from the first to the last of these.
  const waiting: number[] = [];

  /** A further sector of a vertex. */
  const furtherSector = (vertex: number): number => {
    const sector = nVertices + further.push(vertex) - 1;
    points.copyWithin(3 * sector, 3 * vertex, 3 * vertex + 3);
    return sector;
  };

  // The fan around a vertex: its neighbours; and the triangles between them, `size` of them.
  const spokes: number[] = [];
  const isSharp: number[] = [];
  const halves: number[] = []; // in the triangle that follows
  const turned: boolean[] = []; // whether the triangle has the other orientation than the walk
  let size = 0;

  /** Let the normal of a sector wait; it has n triangles, from spoke i on. */
  const wait = (sector: number, i: number, n: number, isTurned: boolean): void => {
    waiting.push(sector, isTurned ? -n : n);
    for (let j = i; j <= i + n; j++) waiting.push(spokes[j]!);
  };

  const u = new Float64Array(3);
  const w = new Float64Array(3);
  /** Set the normal of a sector from its tangents u and w; where they have none it waits. */
  const setNormal = (sector: number, i: number, n: number, isTurned: boolean): void => {
    const x = u[1]! * w[2]! - u[2]! * w[1]!;
    const y = u[2]! * w[0]! - u[0]! * w[2]!;
    const z = u[0]! * w[1]! - u[1]! * w[0]!;
    const length = Math.sqrt(x * x + y * y + z * z) * (isTurned ? -1 : 1);
    normals[3 * sector] = x / length;
    normals[3 * sector + 1] = y / length;
    normals[3 * sector + 2] = z / length;
    if (!length) wait(sector, i, n, isTurned);
  };

  /** The normal of a sector from one sharp edge to another one of a crease (Hoppe et al. 1994). */
  const setCrease = (sector: number, vertex: number, i: number, n: number, isTurned: boolean): void => {
    const table = (creases[n] ??= creaseWeights(n));
    for (let k = 0; k < 3; k++) {
      const own = vertices[3 * vertex + k]!;
      let across = 0;
      for (let j = 0; j <= n; j++) across += table[j]! * (vertices[3 * spokes[i + j]! + k]! - own);
      u[k] = vertices[3 * spokes[i]! + k]! - vertices[3 * spokes[i + n]! + k]!; // the tangent along the crease
      w[k] = across;
    }
    setNormal(sector, i, n, isTurned);
  };

  /** The neighbours of an edge's vertex in the face of half-edge h, with the ends, become the spokes from i on. */
  const setSide = (h: number, i: number): void => {
    spokes[i] = faces[nextHalf(h)]!;
    spokes[i + 1] = nOld + ofHalf[nextHalf(h)]!;
    spokes[i + 2] = nOld + ofHalf[previousHalf(h)]!;
    spokes[i + 3] = faces[h]!;
  };

  /** The sector of an edge's vertex that lies in the face of half-edge h, and ends with it. */
  const setHalf = (h: number, v: number, sector: number): void => {
    ofEdgeVertex[h] = sector;
    setSide(h, 0);
    if (!sharp[ofHalf[h]!]) return wait(sector, 0, 3, false);
    // As `setCrease` for three triangles, without a table.
    for (let k = 0; k < 3; k++) {
      const own = vertices[3 * v + k]!;
      const p = vertices[3 * spokes[0]! + k]!;
      const s = vertices[3 * spokes[3]! + k]!;
      points[3 * sector + k] = (4 * own + p + s) / 6;
      u[k] = p - s;
      w[k] = vertices[3 * spokes[1]! + k]! - own + (vertices[3 * spokes[2]! + k]! - own) - (p - own + (s - own)) / 2;
    }
    setNormal(sector, 0, 3, false);
  };

  /** A vertex on an edge. It has six neighbours, or four on a boundary: the ends, and the middles around. */
  const setEdge = (h: number, o: number): void => {
    const v = nOld + ofHalf[h]!;
    if (sharp[ofHalf[h]!]) {
      setHalf(h, v, v);
      if (o >= 0) setHalf(o, v, furtherSector(v));
      return;
    }
    setSide(h, 0);
    setSide(o, 3);
    for (let k = 0; k < 3; k++) {
      const p = vertices[3 * spokes[0]! + k]!;
      const q = vertices[3 * spokes[1]! + k]!;
      const r = vertices[3 * spokes[2]! + k]!;
      const s = vertices[3 * faces[h]! + k]!;
      const t = vertices[3 * spokes[4]! + k]!;
      const x = vertices[3 * spokes[5]! + k]!;
      points[3 * v + k] = (6 * vertices[3 * v + k]! + p + q + r + s + t + x) / 12;
      // Loop's tangents: sums by the cosines and sines of sixths of a turn; of the second, the root of 3 / 4 is left out.
      u[k] = p - s + (q - r - t + x) / 2;
      w[k] = q + r - t - x;
    }
    if (faces[o] === faces[h]) {
      setHalf(h, v, v);
      setHalf(o, v, furtherSector(v));
    } else {
      ofEdgeVertex[h] = ofEdgeVertex[o] = v;
      setNormal(v, 0, 6, false);
    }
  };

  /** Walk round vertex v from half-edge `from`: anticlockwise, if that starts at v. */
  const walk = (v: number, from: number): void => {
    size = 0;
    let h = from;
    let last = 0;
    do {
      const isAhead = faces[h] === v;
      spokes[size] = isDivided ? nOld + ofHalf[h]! : faces[isAhead ? nextHalf(h) : h]!;
      isSharp[size] = sharp[ofHalf[h]!]!;
      halves[size] = h;
      turned[size++] = !isAhead;
      last = isAhead ? previousHalf(h) : nextHalf(h);
      h = opposite[last]!;
    } while (h >= 0 && h !== from);
    // Behind the last triangle there is the first neighbour again, or that at the boundary.
    if (h < 0) spokes[size] = isDivided ? nOld + ofHalf[last]! : faces[last]! + faces[nextHalf(last)]! - v;
    else spokes[size] = spokes[0]!;
    isSharp[size] = sharp[ofHalf[last]!]!;
  };

  /** A vertex of the topology; `start` is a half-edge that starts at it. */
  const setVertex = (v: number, start: number): void => {
    const nSharp = sharpness[v]!;
    // Where there are sharp edges, turn back to the boundary, or all the way to the last one.
    let from = start;
    if (nSharp) {
      let h = start;
      do {
        if (sharp[ofHalf[h]!]) from = h;
        const o = opposite[h]!;
        h = o < 0 ? start : faces[o] === v ? previousHalf(o) : nextHalf(o);
      } while (h !== start);
    }
    walk(v, from);
    let seam = 1; // where the orientation changes first; `size` where it does not
    while (seam < size && turned[seam] === turned[0]) seam++;
    if (!nSharp && seam < size) walk(v, halves[seam]!); // the first sector starts there
    const at = 3 * v;
    if (nSharp > 1) {
      // On a crease the other sharp edge; a corner stays where it is.
      const a = 3 * spokes[0]!;
      const b = 3 * spokes[isSharp.indexOf(1, 1)]!;
      for (let k = 0; k < 3; k++) {
        const own = vertices[at + k]!;
        points[at + k] = nSharp > 2 ? own : (4 * own + vertices[a + k]! + vertices[b + k]!) / 6;
      }
    } else {
      const table = fanWeights(size);
      let sum = 1;
      for (let k = 0; k < 3; k++) {
        points[at + k] = vertices[at + k]!;
        u[k] = w[k] = 0;
      }
      for (let i = 0; i < size; i++) {
        const share = table[4 * i + 2 + nSharp]!; // darts have weights of their own
        sum += share;
        for (let k = 0; k < 3; k++) {
          const x = vertices[3 * spokes[i]! + k]!;
          u[k]! += table[4 * i]! * x;
          w[k]! += table[4 * i + 1]! * x;
          points[at + k]! += share * x;
        }
      }
      for (let k = 0; k < 3; k++) points[at + k]! /= sum;
    }
    for (let i = 0, end = 0; i < size; i = end) {
      const isTurned = turned[i]!;
      const sector = i ? furtherSector(v) : v;
      do {
        ofCorner[isTurned ? nextHalf(halves[end]!) : halves[end]!] = sector;
        end++;
      } while (end < size && !isSharp[end] && turned[end] === isTurned);
      const n = end - i;
      if (nSharp < 2 && n === size) setNormal(v, 0, n, isTurned);
      else if (nSharp === 2 && isSharp[i] && isSharp[end]) setCrease(sector, v, i, n, isTurned);
      else wait(sector, i, n, isTurned);
    }
  };

  const starts = new Int32Array(nOld);
  for (let h = 0; h < faces.length; h++) {
    starts[faces[h]!] = h;
    if (isDivided && opposite[h]! < h) setEdge(h, opposite[h]!); // each edge once
  }
  for (let v = 0; v < nOld; v++) setVertex(v, starts[v]!);
  for (let i = 0; i < waiting.length; ) i = setByAngles(points, normals, waiting, i);
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

/**
 * Set the normal of the sector that is waiting at i: the unit normals of the triangles between limit points, by their
 * angles. Gives the place of the next one.
 */
function setByAngles(points: Float64Array, normals: Float32Array, waiting: number[], i: number): number {
  const at = 3 * waiting[i]!;
  const n = waiting[i + 1]!;
  const end = i + 3 + Math.abs(n);
  let x = 0, y = 0, z = 0, ax = 0, ay = 0, az = 0;
  for (let j = i + 2; j < end; j++) {
    const p = 3 * waiting[j]!;
    const bx = points[p]! - points[at]!;
    const by = points[p + 1]! - points[at + 1]!;
    const bz = points[p + 2]! - points[at + 2]!;
    const cx = ay * bz - az * by;
    const cy = az * bx - ax * bz;
    const cz = ax * by - ay * bx;
    const area = Math.sqrt(cx * cx + cy * cy + cz * cz);
    const share = area && Math.atan2(area, ax * bx + ay * by + az * bz) / area;
    x += share * cx;
    y += share * cy;
    z += share * cz;
    ax = bx;
    ay = by;
    az = bz;
  }
  const length = (Math.sqrt(x * x + y * y + z * z) || 1) * Math.sign(n);
  normals[at] = x / length;
  normals[at + 1] = y / length;
  normals[at + 2] = z / length;
  return end;
}
