/** Adaptive subdivision: triangles of several levels without gaps, as near to the surface as is needed everywhere. */
import { nextHalf } from "./manifold.js";
import { type LimitMesh, limitMesh } from "./limit.js";
import { divide, nextVertices, type Topology } from "./subdivision.js";

const MAX_LEVEL = 6;
const MOST_FACES = 2 ** 19; // of the finest level
const BEYOND = 0.1; // so many edges of the finest level need not keep to the tolerance

// The triangles of a face by its divided edges: edge k, from corner k to the next, counts 2^k. Points 0 to 2 are its
// corners, 3 + k the middle of edge k.
const CUTS = ["012", "032312", "014042", "314034042", "015512", "503253231", "425145150"];

/**
 * The mesh of a control mesh with these vertices. An edge is divided where the surface is farther from it than the
 * tolerance, which follows from the diagonal. Where `isOriented`, vertices are moved outward, see `balance`.
 */
export function adaptiveMesh(
  mesh: Topology,
  vertices: Float64Array,
  toleranceOf: (diagonal: number) => number,
  isOriented: boolean,
): LimitMesh {
  const faces = mesh.faces;
  const levels: Topology[] = []; // without the finest
  const divided: Uint8Array[] = [];
  let fine = limitMesh(mesh, vertices, false);
  const tolerance = toleranceOf(diagonal(fine.points));
  let error = 0;
  for (let k = 0; k < MAX_LEVEL && (faces.length / 3) * 4 ** (k + 1) <= MOST_FACES; k++) {
    if (k) mesh = divide(mesh);
    vertices = nextVertices(mesh, vertices);
    const next = limitMesh(mesh, vertices, true);
    const found = distances(mesh, next.points);
    const before = k ? error : 0;
    error = found.slice().sort()[Math.floor((1 - BEYOND) * (found.length - 1))]!;
    if (error <= tolerance) break;
    levels.push(mesh);
    divided.push(Uint8Array.from(found, (d) => (d > tolerance ? 1 : 0)));
    fine = next;
    // A step divides the error by four in the end. When that will do, it is believed.
    if (Math.max(before ? error / before : 1, 1 / 4) * error < tolerance) break;
  }
  // Faces of which any edge is divided exist only where the face that they come from is divided as a whole.
  for (let k = levels.length - 1; k > 0; k--) {
    levels[k]!.ofHalf.forEach((e, h) => {
      const whole = 3 * Math.floor(h / 12);
      if (divided[k]![e]) for (let i = whole; i < whole + 3; i++) divided[k - 1]![levels[k - 1]!.ofHalf[i]!] = 1;
    });
  }
  const index: number[] = [];
  const add = (k: number, face: number): void => {
    const finer = 4 ** (levels.length - k); // corner h is corner 4 h of the next level
    let kind = 0;
    if (finer > 1) for (let i = 0; i < 3; i++) kind += divided[k]![levels[k]!.ofHalf[3 * face + i]!]! << i;
    if (kind === 7) for (let i = 0; i < 4; i++) add(k + 1, 4 * face + i);
    // The middle of edge i is corner i of the face in the middle.
    else for (const p of CUTS[kind]!) index.push(fine.index[+p < 3 ? (3 * face + +p) * finer : ((12 * face + 6 + +p) * finer) / 4]!);
  };
  for (let face = 0; face < faces.length / 3; face++) add(0, face);
  fine.index = Uint32Array.from(index);
  if (isOriented) {
    const { sharpness, sharp } = mesh;
    const isSmooth = (v: number): boolean => !(v < sharpness.length ? sharpness[v] : sharp[v - sharpness.length]);
    balance(fine, isSmooth);
  }
  return fine;
}

/** Leave out what no triangle uses. */
export function withoutUnused({ points, normals, index }: LimitMesh): Omit<LimitMesh, "further"> {
  const numbers = new Int32Array(points.length / 3);
  let count = 0; // of those in use; their numbers are from 1
  const renumbered = index.map((v) => (numbers[v] ||= ++count) - 1);
  const made = { points: new Float64Array(3 * count), normals: new Float32Array(3 * count), index: renumbered };
  for (let v = 0; v < numbers.length; v++) {
    const to = 3 * numbers[v]! - 3;
    for (let k = 0; to >= 0 && k < 3; k++) {
      made.points[to + k] = points[3 * v + k]!;
      made.normals[to + k] = normals[3 * v + k]!;
    }
  }
  return made;
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

const product = new Float64Array(3);

/** Set `product` to the cross product of b - a and c - a, each a vertex of points. Gives its length. */
function setProduct(points: Float64Array, a: number, b: number, c: number): number {
  for (let k = 0; k < 3; k++) {
    const i = (k + 1) % 3;
    const j = (k + 2) % 3;
    const x = points[3 * a + i]!;
    const y = points[3 * a + j]!;
    product[k] = (points[3 * b + i]! - x) * (points[3 * c + j]! - y) - (points[3 * b + j]! - y) * (points[3 * c + i]! - x);
  }
  return Math.sqrt(product[0]! ** 2 + product[1]! ** 2 + product[2]! ** 2);
}

/**
 * How far the limit surface is from each edge's middle: from the planes of the triangles beside it, and of a sharp edge
 * from itself, too. `points` are those of the next level.
 */
function distances({ faces, ofHalf, sharp, valences }: Topology, points: Float64Array): Float64Array {
  const out = new Float64Array(sharp.length);
  const length = (a: number, b: number): number =>
    Math.sqrt(
      (points[3 * b]! - points[3 * a]!) ** 2 + (points[3 * b + 1]! - points[3 * a + 1]!) ** 2 + (points[3 * b + 2]! - points[3 * a + 2]!) ** 2,
    );
  for (let h = 0; h < faces.length; h++) {
    const a = faces[h]!;
    const b = faces[nextHalf(h)]!;
    const e = ofHalf[h]!;
    const middle = valences.length + e;
    const size = setProduct(points, a, b, faces[nextHalf(nextHalf(h))]!);
    let far = 0;
    for (let k = 0; size && k < 3; k++) far += (product[k]! / size) * (points[3 * middle + k]! - points[3 * a + k]!);
    far = Math.abs(far);
    if (sharp[e]) {
      const chord = length(a, b);
      far = Math.max(far, chord ? setProduct(points, a, b, middle) / chord : length(a, middle));
    }
    if (far > out[e]!) out[e] = far;
  }
  return out;
}

/**
 * Move smooth vertices off the surface by a quarter of their height over the mean of their neighbours: then the
 * triangles are as much outside as inside of it.
 */
function balance({ points, index }: LimitMesh, isSmooth: (vertex: number) => boolean): void {
  const n = points.length;
  const normals = new Float64Array(n);
  const sums = new Float64Array(n);
  const counts = new Float64Array(n / 3);
  for (let t = 0; t < index.length; t += 3) {
    const a = index[t]!;
    const b = index[t + 1]!;
    const c = index[t + 2]!;
    setProduct(points, a, b, c);
    for (let i = t; i < t + 3; i++) {
      const v = index[i]!;
      counts[v]! += 3;
      for (let k = 0; k < 3; k++) {
        normals[3 * v + k]! += product[k]!;
        sums[3 * v + k]! += points[3 * a + k]! + points[3 * b + k]! + points[3 * c + k]!;
      }
    }
  }
  for (let v = 0; v < n / 3; v++) {
    let height = 0;
    let square = 0;
    for (let i = 3 * v; i < 3 * v + 3; i++) {
      height += (points[i]! * counts[v]! - sums[i]!) * normals[i]!;
      square += normals[i]! ** 2;
    }
    // Of the corners around, a third are the vertex itself: hence 3 / 2.
    if (square && isSmooth(v)) for (let i = 3 * v; i < 3 * v + 3; i++) points[i]! += ((3 / 8) * height * normals[i]!) / (counts[v]! * square);
  }
}
