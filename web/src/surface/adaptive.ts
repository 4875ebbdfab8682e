/** Meshes of the limit surface: triangles of several levels without gaps, as near to it as is needed everywhere. */
import { nextHalf } from "./manifold.js";
import { type Sectors, sectorsOf, type Step } from "./sectors.js";
import { divide, limitPoints, nextLimitPoints, nextVertices, type Topology } from "./subdivision.js";
import { measure, measured } from "./vectors.js";

const BEYOND = 0.1; // so many edges of the finest level need not keep to the tolerance

// The triangles of a face by its divided edges, unless all are: edge k, from corner k to the next, counts 2^k. Points 0 to
// 2 are its corners, 3 + k the middle of edge k.
const CUTS = ["012", "032312", "014042", "314034042", "015512", "503253231", "425145150"].map((cut) =>
  [...cut].map(Number),
);

export interface LimitMesh extends Pick<Sectors, "ofSector" | "normals"> {
  /** Points of the limit surface, three coordinates per vertex. */
  points: Float64Array;
  /** Three sectors per triangle. */
  index: Uint32Array;
}

/**
 * The mesh of a control mesh with these vertices. An edge is divided where the surface is farther from it than the
 * tolerance, which follows from the diagonal, up to `maxLevel` times; without a tolerance all edges are, so often. Where
 * `isBalanced`, vertices are moved outward, see `balance`.
 */
export function limitMesh(
  control: Topology,
  vertices: Float64Array,
  maxLevel: number,
  isBalanced: boolean,
  toleranceOf?: (diagonal: number) => number,
): LimitMesh {
  const steps: Step[] = [];
  let mesh = control;
  let next = nextVertices(mesh, vertices);
  let points = limitPoints(mesh, vertices, next);
  const tolerance = toleranceOf?.(diagonal(points)) ?? 0;
  let error = 0; // of the level before
  for (let k = 0; k < maxLevel; k++) {
    if (k) {
      mesh = divide(mesh);
      next = nextVertices(mesh, next);
    }
    const finer = nextLimitPoints(mesh, next, points);
    const n = mesh.sharp.length;
    const divided = new Uint8Array(n).fill(1);
    const before = error;
    if (toleranceOf) {
      const far = setFar(divided, distances(mesh, finer), tolerance);
      const nBeyond = n - 1 - Math.floor((1 - BEYOND) * (n - 1));
      if (far.length <= nBeyond) break;
      if (k < maxLevel - 1) error = far.sort()[far.length - 1 - nBeyond]!;
    }
    steps.push({ mesh, refined: next, divided });
    points = finer;
    // The next step divides the error as the last one did, by four at most: when that will do, it is believed.
    if (Math.max(error / before, 1 / 4) * error < tolerance) break;
  }
  for (let k = steps.length - 1; k > 0; k--) setWhole(steps[k - 1]!, steps[k]!);
  const { ofSector, normals, ofCorner, ofNew } = sectorsOf(control, vertices, steps, points);
  // Triangles that are chosen take the place of the last level's, in order: they are never more than those they stand for.
  const index = new Uint32Array(ofCorner.at(-1)!.buffer);
  let size = 0;
  const add = (k: number, face: number): void => {
    let kind = 0;
    const step = steps[k];
    if (step) for (let i = 0; i < 3; i++) kind += step.divided[step.mesh.ofHalf[3 * face + i]!]! << i;
    if (kind === 7) {
      for (let i = 0; i < 4; i++) add(k + 1, 4 * face + i);
    } else {
      for (const p of CUTS[kind]!) index[size++] = p < 3 ? ofCorner[k]![3 * face + p]! : ofNew[k]![3 * face + p - 3]!;
    }
  };
  if (!toleranceOf) size = index.length;
  else for (let face = 0; face < control.faces.length / 3; face++) add(0, face);
  const made = { ofSector, normals, points, index: index.slice(0, size) };
  if (isBalanced) balance(made, steps.at(-1)?.mesh ?? mesh);
  return made;
}

/** Set which edges are farther than the tolerance. Gives the distances of those, in the memory of all. */
function setFar(divided: Uint8Array, distances: Float64Array, tolerance: number): Float64Array {
  let n = 0;
  for (let e = 0; e < distances.length; e++) {
    divided[e] = distances[e]! > tolerance ? 1 : 0;
    if (divided[e]) distances[n++] = distances[e]!;
  }
  return distances.subarray(0, n);
}

/** Faces of which any edge is divided exist only where the face that they come from is divided as a whole. */
function setWhole(coarse: Step, fine: Step): void {
  const { ofHalf } = fine.mesh;
  for (let h = 0; h < ofHalf.length; h++) {
    if (!fine.divided[ofHalf[h]!]) continue;
    const whole = 3 * Math.floor(h / 12);
    for (let i = whole; i < whole + 3; i++) coarse.divided[coarse.mesh.ofHalf[i]!] = 1;
  }
}

/** The length of the diagonal of the bounding box of points. */
function diagonal(points: Float64Array): number {
  let square = 0;
  for (let k = 0; k < 3; k++) {
    let low = Infinity;
    let high = -Infinity;
    for (let i = k; i < points.length; i += 3) {
      low = Math.min(low, points[i]!);
      high = Math.max(high, points[i]!);
    }
    square += (high - low) ** 2;
  }
  return Math.sqrt(square);
}

/**
 * How far the limit surface is from each edge's middle: from the planes of the triangles beside it, and of a sharp edge
 * from itself, too. `points` are those of the next level.
 */
function distances({ faces, ofHalf, sharp, valences }: Topology, points: Float64Array): Float64Array {
  const out = new Float64Array(sharp.length);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f]!;
    const size = measure(points, a, 3 * faces[f + 1]!, 3 * faces[f + 2]!) || 1;
    const x = measured[0]! / size;
    const y = measured[1]! / size;
    const z = measured[2]! / size;
    for (let h = f; h < f + 3; h++) {
      const e = ofHalf[h]!;
      const m = 3 * (valences.length + e);
      const height = x * (points[m]! - points[a]!) + y * (points[m + 1]! - points[a + 1]!) + z * (points[m + 2]! - points[a + 2]!);
      out[e] = Math.max(out[e]!, Math.abs(height));
    }
  }
  for (let h = 0; h < faces.length; h++) {
    const e = ofHalf[h]!;
    if (!sharp[e]) continue;
    const a = 3 * faces[h]!;
    const b = 3 * faces[nextHalf(h)]!;
    const m = 3 * (valences.length + e);
    const chord = distance(points, a, b);
    out[e] = Math.max(out[e]!, chord ? measure(points, a, b, m) / chord : distance(points, a, m));
  }
  return out;
}

const distance = (points: Float64Array, a: number, b: number): number =>
  Math.hypot(points[b]! - points[a]!, points[b + 1]! - points[a + 1]!, points[b + 2]! - points[a + 2]!);

/**
 * Move smooth vertices off the surface by a quarter of their height over the mean of their neighbours: then the
 * triangles are as much outside as inside of it. Those of an oriented mesh have one sector each.
 */
function balance({ points, index, ofSector }: LimitMesh, { sharp, sharpness }: Topology): void {
  const sums = new Float64Array(7 * ofSector.length); // of normals, neighbours, and corners
  for (let t = 0; t < index.length; t += 3) {
    const a = 3 * ofSector[index[t]!]!;
    const b = 3 * ofSector[index[t + 1]!]!;
    const c = 3 * ofSector[index[t + 2]!]!;
    measure(points, a, b, c);
    for (let k = 0; k < 3; k++) {
      const normal = measured[k]!;
      const sum = points[a + k]! + points[b + k]! + points[c + k]!;
      for (let i = t; i < t + 3; i++) {
        sums[7 * index[i]! + k]! += normal;
        sums[7 * index[i]! + 3 + k]! += sum;
      }
    }
    for (let i = t; i < t + 3; i++) sums[7 * index[i]! + 6]! += 3;
  }
  for (let sector = 0, s = 0; sector < ofSector.length; sector++, s += 7) {
    const v = ofSector[sector]!;
    let height = 0;
    let square = 0;
    for (let k = 0; k < 3; k++) {
      height += (points[3 * v + k]! * sums[s + 6]! - sums[s + 3 + k]!) * sums[s + k]!;
      square += sums[s + k]! ** 2;
    }
    // Of the corners around, a third are the vertex itself: hence 3 / 2.
    if (!square || (sharpness[v] ?? sharp[v - sharpness.length])) continue;
    for (let k = 0; k < 3; k++) points[3 * v + k]! += ((3 / 8) * height * sums[s + k]!) / (sums[s + 6]! * square);
  }
}
