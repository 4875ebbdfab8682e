/** Sectors of vertices and their normals on the limit surface: spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf, unset } from "./manifold.js";
import { divide, divideCorners, type Topology } from "./subdivision.js";
import { measure, measured } from "./vectors.js";

/** One step of subdivision. */
export interface Step {
  /** What is divided. */
  mesh: Topology;
  /** The vertices after the step. */
  refined: Float64Array;
  /** 1 for each edge of `mesh` whose new vertex is used. */
  divided: Uint8Array;
}

/**
 * Across a sharp edge the limit surface bends, so a vertex has a normal per *sector*: the corners around it from one
 * sharp edge to the next, or all.
 */
export interface Sectors {
  /** The vertex of each sector. */
  ofSector: Int32Array;
  /** Unit normals, three coordinates per sector. */
  normals: Float32Array;
  /** Of the control mesh and after each step, the sector of each corner... */
  ofCorner: Int32Array[];
  /** ... and per step that of the new vertex of each half-edge, in its face; -1 where it is not used. */
  ofNew: Int32Array[];
}

/**
 * The sectors of all vertices of a control mesh, and of those that steps make of it where they are used. `points` are the
 * limit points of the vertices after all steps.
 */
export function sectorsOf(
  control: Topology,
  vertices: Float64Array,
  steps: Step[],
  points: Float64Array,
): Sectors {
  let most = control.faces.length;
  for (const { divided } of steps) for (let e = 0; e < divided.length; e++) most += 2 * divided[e]!;
  const ofSector = new Int32Array(most);
  const normals = new Float32Array(3 * most);
  let size = 0;
  const bare: number[] = []; // sectors without tangents, whose normals are NaN until the end
  let sums: Float64Array | undefined; // of theirs, those of the triangles at their corners
  const spokes = new Int32Array(control.faces.length + 4); // the neighbours of a vertex

  /** Add a sector of a vertex. Its tangents are sums over the spokes, with two weights for each. */
  const add = (vertex: number, weights: Float64Array): number => {
    let sx = 0;
    let sy = 0;
    let sz = 0;
    let tx = 0;
    let ty = 0;
    let tz = 0;
    const own = 3 * vertex;
    for (let i = 0; i < weights.length; i += 2) {
      const at = 3 * spokes[i >> 1]!;
      const s = weights[i]!;
      const t = weights[i + 1]!;
      const x = vertices[at]! - vertices[own]!;
      const y = vertices[at + 1]! - vertices[own + 1]!;
      const z = vertices[at + 2]! - vertices[own + 2]!;
      sx += s * x;
      sy += s * y;
      sz += s * z;
      tx += t * x;
      ty += t * y;
      tz += t * z;
    }
    const x = sy * tz - sz * ty;
    const y = sz * tx - sx * tz;
    const z = sx * ty - sy * tx;
    const length = Math.sqrt(x * x + y * y + z * z);
    if (!length) bare.push(size);
    normals[3 * size] = x / length;
    normals[3 * size + 1] = y / length;
    normals[3 * size + 2] = z / length;
    ofSector[size] = vertex;
    return size++;
  };

  /** Add to the sum of a sector of vertex p: the normal of triangle p q r, times its angle at p. */
  const addTriangle = (sector: number, p: number, q: number, r: number): void => {
    const area = measure(points, 3 * p, 3 * q, 3 * r);
    const share = area && Math.atan2(area, measured[3]!) / area;
    sums ??= new Float64Array(3 * most);
    for (let k = 0; k < 3; k++) sums[3 * sector + k]! += share * measured[k]!;
  };

  const rounds: Float64Array[] = [];
  const round = (n: number): Float64Array => (rounds[n] ??= roundTangents(n));
  const crease = creaseTangents(3);
  // The normals of some control vertices change from step to step: they are those after the last.
  const { faces, ofHalf, opposite, sharp, valences, sharpness } = control;
  const last = steps.at(-1);
  const scale = 4 ** (steps.length - 1); // corner h is corner 4 h after a step
  const neighbour = (h: number, vertex: number): number =>
    last ? last.mesh.valences.length + last.mesh.ofHalf[h]! : vertex;
  vertices = last?.refined ?? vertices;
  const first = unset(faces.length);
  for (let h = 0; h < faces.length; h++) {
    if (first[h]! >= 0) continue;
    const vertex = faces[h]!;
    let start = h;
    while (!sharp[ofHalf[start]!] && faces[opposite[start]!] !== vertex) {
      start = nextHalf(opposite[start]!);
      if (start === h) break;
    }
    let n = 0;
    let end = 0;
    let corner = 0;
    let next = start;
    do {
      corner = next;
      first[corner] = size;
      spokes[n++] = neighbour(corner * scale, faces[nextHalf(corner)]!);
      end = previousHalf(corner);
      next = opposite[end]!;
    } while (!sharp[ofHalf[end]!] && faces[next] === vertex && next !== start);
    spokes[n] = neighbour(previousHalf(corner * scale), faces[end]!);
    const isCrease = sharpness[vertex] === 2 && sharp[ofHalf[start]!] && sharp[ofHalf[end]!];
    add(vertex, isCrease ? creaseTangents(n) : round(sharpness[vertex]! < 2 && n === valences[vertex] ? n : 0));
    if (bare.at(-1) === size - 1) while (n--) addTriangle(size - 1, vertex, spokes[n]!, spokes[n + 1]!);
  }
  const nFirst = size;
  const ofCorner = [first];
  const ofNew: Int32Array[] = [];
  for (let k = 0; k < steps.length; k++) {
    const { mesh, refined, divided } = steps[k]!;
    const { faces, ofHalf, opposite, sharp, valences } = mesh;
    const nOld = valences.length;
    const made = unset(faces.length);
    vertices = refined;
    /** The neighbours of the new vertex of half-edge h that are in its face become the spokes from i on. */
    const setSpokes = (h: number, i: number): void => {
      spokes[i] = faces[nextHalf(h)]!;
      spokes[i + 1] = nOld + ofHalf[nextHalf(h)]!;
      spokes[i + 2] = nOld + ofHalf[previousHalf(h)]!;
      spokes[i + 3] = faces[h]!;
    };
    for (let h = 0; h < faces.length; h++) {
      const o = opposite[h]!;
      const e = ofHalf[h]!;
      if (o >= h || !divided[e]) continue; // each edge once
      const isOne = !sharp[e] && faces[o] !== faces[h]; // sector, of both faces
      const weights = sharp[e] ? crease : round(isOne ? 6 : 0);
      setSpokes(h, 0);
      if (isOne) setSpokes(o, 3);
      made[h] = add(nOld + e, weights);
      if (isOne) made[o] = made[h]!;
      else if (o >= 0) {
        setSpokes(o, 0);
        made[o] = add(nOld + e, weights);
      }
    }
    ofNew.push(made);
    ofCorner.push(divideCorners(ofCorner[k]!, made));
  }
  if (bare.at(-1)! >= nFirst) {
    const finest = divide(last!.mesh).faces;
    const corners = ofCorner.at(-1)!;
    for (let h = 0; h < finest.length; h++) {
      const sector = corners[h]!; // below 0: not used
      if (sector >= nFirst && isNaN(normals[3 * sector]!)) {
        addTriangle(sector, finest[h]!, finest[nextHalf(h)]!, finest[previousHalf(h)]!);
      }
    }
  }
  for (const sector of bare) {
    const sum = sums!.subarray(3 * sector, 3 * sector + 3);
    const length = Math.hypot(...sum) || 1;
    normals.set(sum.map((x) => x / length), 3 * sector);
  }
  return { ofSector: ofSector.slice(0, size), normals: normals.slice(0, 3 * size), ofCorner, ofNew };
}

/** Of n neighbours around a vertex, weights in Loop's tangents. */
function roundTangents(n: number): Float64Array {
  return new Float64Array(2 * n).map((_, i) => Math[i & 1 ? "sin" : "cos"]((2 * Math.PI * (i >> 1)) / n));
}

/** Of n + 1 neighbours from one end of a crease to the other, weights in the tangents along it and across. */
function creaseTangents(n: number): Float64Array {
  const x = Math.PI / n;
  const end = n === 1 ? 1 : -Math.cos(x) / Math.tan(x / 2) / (1 + 2 * Math.cos(x));
  const out: number[] = [];
  for (let i = 0; i <= n; i++) out.push(+(i === 0) - +(i === n), i % n ? Math.sin(i * x) : end);
  return Float64Array.from(out);
}
