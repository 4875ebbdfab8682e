/** The limit surface of a subdivided mesh: points and normals, spec/cndhf.md, section 6.2. */
import { nextHalf, previousHalf } from "./manifold.js";
import { CORNER, CREASE, NONE, SMOOTH, Stencils } from "./stencils.js";
import type { Topology } from "./subdivision.js";

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
  const stencils = new Stencils(vertices, points, normals);
  const ofCorner = new Uint32Array(faces.length);
  const ofEdgeVertex = new Uint32Array(isDivided ? faces.length : 0); // per half-edge: the sector in its face

  const furtherSector = (vertex: number): number => nVertices + further.push(vertex) - 1;

  /** The middles of the other edges of a half-edge's face. */
  const putMiddles = (h: number): void => {
    stencils.put(nOld + ofHalf[nextHalf(h)]!);
    stencils.put(nOld + ofHalf[previousHalf(h)]!);
  };

  /** All that lies around an edge's vertex. */
  const putRing = (h: number, o: number): void => {
    stencils.put(faces[nextHalf(h)]!);
    putMiddles(h);
    stencils.put(faces[h]!);
    putMiddles(o);
    stencils.put(faces[nextHalf(h)]!);
  };

  /** The sector of an edge's vertex in the face of one half-edge, where that is not the whole. */
  const setHalf = (h: number, sector: number, v: number, kind: number): void => {
    ofEdgeVertex[h] = sector;
    stencils.begin(sector, kind, 3, false, v);
    stencils.put(faces[nextHalf(h)]!);
    putMiddles(h);
    stencils.put(faces[h]!);
  };

  /** The vertex on an edge. */
  const setEdge = (h: number, o: number): void => {
    const v = nOld + ofHalf[h]!;
    if (sharp[ofHalf[h]!]) {
      setHalf(h, v, v, CREASE);
      if (o >= 0) setHalf(o, furtherSector(v), v, CREASE);
    } else if (faces[o] === faces[h]) {
      for (const [g, sector] of [[h, v], [o, furtherSector(v)]] as const) {
        stencils.begin(sector, SMOOTH, 6, false, v);
        putRing(h, o);
        setHalf(g, sector, v, NONE);
      }
    } else {
      ofEdgeVertex[h] = ofEdgeVertex[o] = v;
      stencils.begin(v, SMOOTH, 6, false, v);
      putRing(h, o);
    }
  };

  // The fan around a vertex: its neighbours; and the triangles between them, `size` of them.
  const spokes: number[] = [];
  const isSharp: number[] = [];
  const halves: number[] = []; // in the triangle that follows
  const turned: boolean[] = []; // whether the triangle has the other orientation than the walk
  let size = 0;

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
    if (h >= 0) spokes[size] = spokes[0]!;
    else spokes[size] = isDivided ? nOld + ofHalf[last]! : faces[last]! + faces[nextHalf(last)]! - v;
    isSharp[size] = sharp[ofHalf[last]!]!;
  };

  /** A vertex of the topology; `start` is a half-edge that starts at it. */
  const setVertex = (v: number, start: number): void => {
    const nSharp = sharpness[v]!;
    let from = start;
    if (nSharp) {
      // Turn back to the boundary, or all the way to the last sharp edge.
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
    for (let i = 0, end = 0; i < size; i = end) {
      const isTurned = turned[i]!;
      const sector = i ? furtherSector(v) : v;
      do {
        ofCorner[isTurned ? nextHalf(halves[end]!) : halves[end]!] = sector;
        end++;
      } while (end < size && !isSharp[end] && turned[end] === isTurned);
      let kind = nSharp > 2 ? CORNER : nSharp;
      if (nSharp === 2 ? !(isSharp[i] && isSharp[end]) : nSharp < 2 && seam < size) {
        // A seam ends the sector: its point comes of more than its own triangles, its normal of these.
        stencils.begin(sector, kind, nSharp < 2 ? size : 1, false, v);
        for (let j = 0; j <= size; j++) if (nSharp < 2 || j === 0 || j === isSharp.indexOf(1, 1)) stencils.put(spokes[j]!);
        kind = NONE;
      }
      stencils.begin(sector, kind, end - i, isTurned, v);
      for (let j = i; j <= end; j++) stencils.put(spokes[j]!);
    }
  };

  const starts = new Int32Array(nOld);
  for (let h = 0; h < faces.length; h++) {
    starts[faces[h]!] = h;
    if (isDivided && opposite[h]! < h) setEdge(h, opposite[h]!); // each edge once
  }
  for (let v = 0; v < nOld; v++) setVertex(v, starts[v]!);
  stencils.finish();
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
