/**
 * Normals of the limit surface. Across a sharp edge it bends, so a normal belongs to a *sector*: the corners of faces
 * around a vertex from one sharp edge to the next, or all around it.
 */
import type { Level, Topology, Valences } from "./subdivision.js";

export interface Sectors {
  /** The vertex of each sector. */
  vertices: number[];
  /** The sector of each corner of a face. */
  ofCorner: Int32Array;
  /** Three coordinates per sector: unit normals. */
  normals: Float64Array;
}

/** Sectors and their normals. `limit`: the limit points of the vertices. */
export function sectorsOf(level: Level, valences: Valences, limit: Float64Array): Sectors {
  const { topology } = level;
  const { faces, sharp, faceEdges } = topology;
  const following = followingCorners(topology);
  const isFirst = new Uint8Array(faces.length).fill(1);
  for (const h of following) if (h >= 0) isFirst[h] = 0;
  const vertices: number[] = [];
  const ofCorner = new Int32Array(faces.length).fill(-1);
  const normals = new Float64Array(3 * faces.length);
  const corners: number[] = [];
  // First the sectors that have a first corner; what is left then are rings.
  for (const ring of [false, true]) {
    for (let start = 0; start < faces.length; start++) {
      if (ofCorner[start]! >= 0 || !(ring || isFirst[start])) continue;
      const sector = vertices.length;
      corners.length = 0;
      for (let h = start; h >= 0 && ofCorner[h]! < 0; h = following[h]!) {
        ofCorner[h] = sector;
        corners.push(h);
      }
      const v = faces[start]!;
      vertices.push(v);
      const nSharp = valences.sharp[v]!;
      const last = corners[corners.length - 1]!;
      let normal: Vector = [0, 0, 0];
      if (nSharp < 2 && corners.length === valences.edges[v]) normal = smoothNormal(level, corners);
      else if (nSharp === 2 && sharp[faceEdges[start]!] && sharp[faceEdges[before(last)]!]) {
        normal = creaseNormal(level, corners);
      }
      // Corners, and what the above leaves without a direction.
      if (!normal.some((x) => x)) normal = normalByAngles(faces, limit, corners);
      normals.set(normal, 3 * sector);
    }
  }
  return { vertices, ofCorner, normals: normals.subarray(0, 3 * vertices.length) };
}

type Vector = [number, number, number];

const after = (h: number): number => (h % 3 === 2 ? h - 2 : h + 1);
const before = (h: number): number => (h % 3 ? h - 1 : h + 2);

/** The next corner anticlockwise at the same vertex; -1 at a sharp edge and where neighbours disagree in orientation. */
function followingCorners({ faces, faceEdges, ends, sharp }: Topology): Int32Array {
  // An edge as it leaves its first end has the number 2 e, as it leaves its second 2 e + 1.
  const leaving = (edge: number, v: number): number => 2 * edge + (ends[2 * edge] === v ? 0 : 1);
  const owner = new Int32Array(2 * sharp.length).fill(-1);
  for (let h = 0; h < faces.length; h++) owner[leaving(faceEdges[h]!, faces[h]!)] = h;
  return faces.map((v, h) => {
    const behind = faceEdges[before(h)]!;
    return sharp[behind] ? -1 : owner[leaving(behind, v)]!;
  });
}

/** The cross product of Loop's two tangents. */
function smoothNormal(level: Level, corners: number[]): Vector {
  const table = waves(corners.length);
  const [u, v]: [Vector, Vector] = [[0, 0, 0], [0, 0, 0]];
  corners.forEach((h, i) => {
    addArm(u, level, h, after(h), table[2 * i]!);
    addArm(v, level, h, after(h), table[2 * i + 1]!);
  });
  return unit(cross(u, v));
}

/** The tangent along a crease, and the one across it on the side of the sector (Hoppe et al. 1994). */
function creaseNormal(level: Level, corners: number[]): Vector {
  const n = corners.length;
  const x = Math.PI / n;
  // The weight of the two arms along the crease; a single face has the sum of the two.
  const end = n === 1 ? 1 : -Math.cos(x) / Math.tan(x / 2) / (1 + 2 * Math.cos(x));
  const [u, v]: [Vector, Vector] = [[0, 0, 0], [0, 0, 0]];
  corners.forEach((h, i) => addArm(v, level, h, after(h), i ? Math.sin(i * x) : end));
  const [first, last] = [corners[0]!, corners[n - 1]!];
  addArm(u, level, first, after(first), 1);
  addArm(u, level, last, before(last), -1);
  addArm(v, level, last, before(last), end);
  return unit(cross(u, v));
}

/** The normals of the triangles between limit points, by their angles. */
function normalByAngles(faces: Int32Array, limit: Float64Array, corners: number[]): Vector {
  const sum: Vector = [0, 0, 0];
  for (const h of corners) {
    const [p, q, r] = [faces[h]!, faces[after(h)]!, faces[before(h)]!];
    const a = unit(difference(limit, q, p));
    const b = unit(difference(limit, r, p));
    const n = unit(cross(difference(limit, q, p), difference(limit, r, p)));
    const angle = 2 * Math.atan2(
      Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]),
      Math.hypot(a[0] + b[0], a[1] + b[1], a[2] + b[2]),
    );
    for (let k = 0; k < 3; k++) sum[k]! += angle * n[k]!;
  }
  return unit(sum);
}

const tables = new Map<number, Float64Array>();

/** cos and sin of 2 pi i / n in turn. */
function waves(n: number): Float64Array {
  let table = tables.get(n);
  if (!table) {
    table = Float64Array.from({ length: 2 * n }, (_, i) => {
      const angle = (2 * Math.PI * (i >> 1)) / n;
      return i % 2 ? Math.sin(angle) : Math.cos(angle);
    });
    if (n < 32) tables.set(n, table);
  }
  return table;
}

/** Add to `sum` the arm from corner h to another corner of its face, times a weight. */
function addArm(sum: Vector, { topology, vertices }: Level, h: number, to: number, weight: number): void {
  const [a, b] = [3 * topology.faces[h]!, 3 * topology.faces[to]!];
  for (let k = 0; k < 3; k++) sum[k]! += weight * (vertices[b + k]! - vertices[a + k]!);
}

function difference(points: Float64Array, p: number, q: number): Vector {
  return [
    points[3 * p]! - points[3 * q]!, points[3 * p + 1]! - points[3 * q + 1]!, points[3 * p + 2]! - points[3 * q + 2]!,
  ];
}

function cross([a, b, c]: Vector, [x, y, z]: Vector): Vector {
  return [b * z - c * y, c * x - a * z, a * y - b * x];
}

/** A vector at length one; zero stays zero. */
function unit(v: Vector): Vector {
  const length = Math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2);
  return length > 0 ? [v[0] / length, v[1] / length, v[2] / length] : [0, 0, 0];
}
