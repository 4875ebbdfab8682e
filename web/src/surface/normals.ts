/**
 * Normals of the limit surface. Across a sharp edge it bends, so a normal belongs to a *sector*: the corners of faces
 * around a vertex from one sharp edge to the next, or all around it.
 */
import { nextHalf, previousHalf } from "./manifold.js";
import { leaving, type Level, type Topology, type Valences } from "./subdivision.js";

export interface Sectors {
  /** The vertex of each sector. */
  vertices: number[];
  /** The sector of each corner of a face. */
  ofCorner: Uint32Array;
  /** Unit normals, three coordinates per sector. */
  normals: Float32Array;
}

/** Sectors and their normals. `limit`: the limit points of the vertices. */
export function sectorsOf({ topology, vertices }: Level, valences: Valences, limit: Float64Array): Sectors {
  const { faces, sharp, faceEdges } = topology;
  const following = followingCorners(topology);
  const isFirst = new Uint8Array(faces.length).fill(1);
  for (let h = 0; h < faces.length; h++) if (following[h]! >= 0) isFirst[following[h]!] = 0;
  const owners: number[] = [];
  const ofCorner = new Uint32Array(faces.length);
  const seen = new Uint8Array(faces.length);
  const normals = new Float32Array(3 * faces.length);
  // First the sectors that have a first corner; what is left then are rings.
  for (let ring = 0; ring < 2; ring++) {
    for (let start = 0; start < faces.length; start++) {
      if (seen[start] || !(ring || isFirst[start])) continue;
      const v = faces[start]!;
      const nSharp = valences.sharp[v]!;
      const isSmooth = nSharp < 2;
      const table = isSmooth ? waves(valences.edges[v]!) : NONE;
      const centre = 3 * v;
      // Loop's two tangents, a and b: sums of the arms ahead of the corners, weighted by cosines and sines.
      let ax = 0;
      let ay = 0;
      let az = 0;
      let bx = 0;
      let by = 0;
      let bz = 0;
      let last = start;
      let size = 0;
      for (let h = start; h >= 0 && !seen[h]; h = following[h]!) {
        ofCorner[h] = owners.length;
        seen[h] = 1;
        if (isSmooth) {
          const cos = table[2 * size]!;
          const sin = table[2 * size + 1]!;
          const end = 3 * faces[nextHalf(h)]!;
          const x = vertices[end]! - vertices[centre]!;
          const y = vertices[end + 1]! - vertices[centre + 1]!;
          const z = vertices[end + 2]! - vertices[centre + 2]!;
          ax += cos * x;
          ay += cos * y;
          az += cos * z;
          bx += sin * x;
          by += sin * y;
          bz += sin * z;
        }
        last = h;
        size++;
      }
      let normal = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
      if (isSmooth ? size < valences.edges[v]! : nSharp > 2) normal = NONE;
      else if (!isSmooth) {
        const isWhole = sharp[faceEdges[start]!] && sharp[faceEdges[previousHalf(last)]!];
        normal = isWhole ? creaseNormal(faces, vertices, following, start, size) : NONE;
      }
      // Corners, and what the above leaves without a direction.
      if (!normal.some((x) => x)) normal = normalByAngles(faces, limit, following, start, size);
      const length = Math.hypot(normal[0]!, normal[1]!, normal[2]!) || 1;
      for (let k = 0; k < 3; k++) normals[3 * owners.length + k] = normal[k]! / length;
      owners.push(v);
    }
  }
  return { vertices: owners, ofCorner, normals: normals.slice(0, 3 * owners.length) };
}

const NONE: number[] = [];

/** The next corner anticlockwise at the same vertex; -1 at a sharp edge and where neighbours disagree in orientation. */
function followingCorners({ faces, faceEdges, ends, sharp }: Topology): Int32Array {
  const owner = new Int32Array(2 * sharp.length).fill(-1);
  for (let h = 0; h < faces.length; h++) owner[leaving(ends, faceEdges[h]!, faces[h]!)] = h;
  const out = new Int32Array(faces.length);
  for (let h = 0; h < faces.length; h++) {
    const behind = faceEdges[previousHalf(h)]!;
    out[h] = sharp[behind] ? -1 : owner[leaving(ends, behind, faces[h]!)]!;
  }
  return out;
}

/** The tangent along a crease, and the one across it on the side of the sector (Hoppe et al. 1994). */
function creaseNormal(
  faces: Int32Array, vertices: Float64Array, following: Int32Array, start: number, size: number,
): number[] {
  const angle = Math.PI / size;
  // The weight of the two arms along the crease; a single face has the sum of the two.
  const end = size === 1 ? 1 : -Math.cos(angle) / Math.tan(angle / 2) / (1 + 2 * Math.cos(angle));
  const first = arm(faces, vertices, start, nextHalf(start));
  let across = first.map((x) => x * end);
  let h = start;
  for (let i = 1; i < size; i++) {
    h = following[h]!;
    const next = arm(faces, vertices, h, nextHalf(h));
    across = across.map((x, k) => x + Math.sin(i * angle) * next[k]!);
  }
  const last = arm(faces, vertices, h, previousHalf(h));
  return cross(first.map((x, k) => x - last[k]!), across.map((x, k) => x + end * last[k]!));
}

/** The normals of the triangles between limit points, by their angles. */
function normalByAngles(
  faces: Int32Array, limit: Float64Array, following: Int32Array, start: number, size: number,
): number[] {
  let sum = [0, 0, 0];
  for (let i = 0, h = start; i < size; i++, h = following[h]!) {
    const a = unit(arm(faces, limit, h, nextHalf(h)));
    const b = unit(arm(faces, limit, h, previousHalf(h)));
    const n = unit(cross(a, b));
    const angle = 2 * Math.atan2(Math.hypot(...a.map((x, k) => x - b[k]!)), Math.hypot(...a.map((x, k) => x + b[k]!)));
    sum = sum.map((x, k) => x + angle * n[k]!);
  }
  return sum;
}

/** From the vertex of corner h to that of another corner. */
const arm = (faces: Int32Array, points: Float64Array, h: number, to: number): number[] =>
  [0, 1, 2].map((k) => points[3 * faces[to]! + k]! - points[3 * faces[h]! + k]!);

const cross = (a: number[], b: number[]): number[] =>
  [1, 2, 0].map((i, k) => a[i]! * b[3 - i - k]! - a[3 - i - k]! * b[i]!);

/** A vector at length one; zero stays zero. */
function unit(v: number[]): number[] {
  const length = Math.hypot(...v) || 1;
  return v.map((x) => x / length);
}

const tables: number[][] = [];

/** cos and sin of 2 pi i / n in turn. */
function waves(n: number): number[] {
  return (tables[n] ??= Array.from({ length: 2 * n }, (_, i) => {
    const angle = (2 * Math.PI * (i >> 1)) / n;
    return i % 2 ? Math.sin(angle) : Math.cos(angle);
  }));
}
