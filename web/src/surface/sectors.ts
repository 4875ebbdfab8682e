/** Sectors of vertices and their normals on the limit surface: spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf, unset } from "./manifold.js";
import { divideCorners, type Topology } from "./subdivision.js";
import { arm, cross, dot, u, v, w } from "./vectors.js";

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
  /** Per step, the sector of each corner before it... */
  ofCorner: Int32Array[];
  /** ... and that of the new vertex of each half-edge, in its face; -1 where it is not used. */
  ofNew: Int32Array[];
}

/**
 * The sectors of all vertices of a control mesh, and of those that steps make of it where they are used. `points` are the
 * limit points of the vertices after all steps.
 */
export function sectorsOf(control: Topology, vertices: Float64Array, steps: Step[], points: Float64Array): Sectors {
  let most = control.faces.length;
  for (const { divided } of steps) for (let e = 0; e < divided.length; e++) most += 2 * divided[e]!;
  const ofSector = new Int32Array(most);
  const normals = new Float32Array(3 * most);
  let size = 0;
  let isBare = false; // whether there are sectors without tangents, whose normals are NaN until the end
  const spokes = new Int32Array(control.faces.length + 4); // the neighbours of a vertex

  /** Add a sector of a vertex. Its tangents are sums over the spokes, with two weights for each. */
  const add = (vertex: number, weights: Float64Array): number => {
    u.fill(0);
    v.fill(0);
    for (let i = 0; i < weights.length; i += 2) {
      arm(w, vertices, 3 * vertex, 3 * spokes[i >> 1]!);
      for (let k = 0; k < 3; k++) {
        u[k]! += weights[i]! * w[k]!;
        v[k]! += weights[i + 1]! * w[k]!;
      }
    }
    const length = cross();
    if (!length) isBare = true;
    for (let k = 0; k < 3; k++) normals[3 * size + k] = w[k]! / length;
    ofSector[size] = vertex;
    return size++;
  };

  const rounds: Float64Array[] = [];
  const round = (n: number): Float64Array => (rounds[n] ??= roundTangents(n));
  const crease = creaseTangents(3);
  const none = new Float64Array(0);
  // The normals of some control vertices change from step to step: they are those after the last.
  const { faces, ofHalf, opposite, sharp, valences, sharpness } = control;
  const last = steps.at(-1);
  const nFinest = last?.mesh.valences.length ?? 0;
  const scale = 4 ** (steps.length - 1); // corner h is corner 4 h after a step
  const neighbour = (h: number, vertex: number): number => (last ? nFinest + last.mesh.ofHalf[h]! : vertex);
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
    let corner = start;
    do {
      first[corner] = size;
      end = previousHalf(corner);
      spokes[n++] = neighbour(corner * scale, faces[nextHalf(corner)]!);
      spokes[n] = neighbour(previousHalf(corner * scale), faces[end]!);
      corner = opposite[end]!;
    } while (!sharp[ofHalf[end]!] && faces[corner] === vertex && corner !== start);
    const isCrease = sharpness[vertex] === 2 && sharp[ofHalf[start]!] && sharp[ofHalf[end]!];
    add(vertex, isCrease ? creaseTangents(n) : sharpness[vertex]! < 2 && n === valences[vertex] ? round(n) : none);
  }
  const ofCorner = [first];
  const ofNew: Int32Array[] = [];
  steps.forEach(({ mesh: { faces, ofHalf, opposite, sharp, valences }, refined, divided }, k) => {
    const nOld = valences.length;
    if (k) ofCorner.push(divideCorners(ofCorner[k - 1]!, ofNew[k - 1]!));
    const made = unset(faces.length);
    ofNew.push(made);
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
      setSpokes(h, 0);
      if (!sharp[e] && faces[o] !== faces[h]) {
        setSpokes(o, 3);
        made[h] = made[o] = add(nOld + e, round(6));
        continue;
      }
      made[h] = add(nOld + e, sharp[e] ? crease : none);
      if (o < 0) continue;
      setSpokes(o, 0);
      made[o] = add(nOld + e, sharp[e] ? crease : none);
    }
  });
  if (isBare) {
    const finest = last ? divideCorners(last.mesh.faces, last.mesh.ofHalf.map((e) => nFinest + e)) : faces;
    const corners = last ? divideCorners(ofCorner.at(-1)!, ofNew.at(-1)!) : first;
    setByAngles(normals, points, finest, corners);
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

/** Set normals that are NaN to sums of the unit normals of the triangles at their corners, by their angles. */
function setByAngles(
  normals: Float32Array,
  points: Float64Array,
  faces: Int32Array,
  ofCorner: Int32Array,
): void {
  const sums = new Float64Array(normals.length);
  for (let h = 0; h < faces.length; h++) {
    const sector = ofCorner[h]!;
    if (sector < 0 || !isNaN(normals[3 * sector]!)) continue; // below 0: not used
    const vertex = 3 * faces[h]!;
    arm(u, points, vertex, 3 * faces[nextHalf(h)]!);
    arm(v, points, vertex, 3 * faces[previousHalf(h)]!);
    const area = cross();
    const share = area && Math.atan2(area, dot(u, v)) / area;
    for (let k = 0; k < 3; k++) sums[3 * sector + k]! += share * w[k]!;
  }
  for (let i = 0; i < normals.length; i += 3) {
    if (!isNaN(normals[i]!)) continue;
    const sum = sums.subarray(i, i + 3);
    const length = Math.sqrt(dot(sum, sum)) || 1;
    normals.set(sum.map((x) => x / length), i);
  }
}
