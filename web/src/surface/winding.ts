/** Winding numbers of a closed triangle mesh, by rays along +z. Slices across x say which triangles they may meet. */

/** How often a mesh winds round a point (x, y, z), as a function. Three numbers per point, three vertices per face. */
export function windingNumber(points: Float64Array, faces: Uint32Array): (x: number, y: number, z: number) => number {
  const x = new Float64Array(faces.length).map((_, i) => points[3 * faces[i]!]!);
  const low = x.reduce((a, b) => Math.min(a, b));
  const high = x.reduce((a, b) => Math.max(a, b));
  const ends = (f: number): [number, number] => [
    Math.min(x[f]!, x[f + 1]!, x[f + 2]!),
    Math.max(x[f]!, x[f + 1]!, x[f + 2]!),
  ];
  let extents = 0;
  for (let f = 0; f < faces.length; f += 3) extents += ends(f)[1] - ends(f)[0];
  // So many that a triangle meets four of them on average, or fewer.
  const nSlices = Math.floor(Math.min(1, (high - low) / extents) * faces.length) || 1;
  const place = (x: number): number => Math.floor(((x - low) / (high - low)) * nSlices) || 0;
  const slices: number[][] = Array.from({ length: nSlices + 1 }, () => []); // the faces that meet them
  for (let f = 0; f < faces.length; f += 3) {
    const [first, last] = ends(f).map(place) as [number, number];
    for (let i = first; i <= last; i++) slices[i]!.push(f);
  }

  /** Twice the area of (x, y) and an edge. Exactly opposite from its other side; a zero counts as beside the edge. */
  const turn = (a: number, b: number, x: number, y: number): number => {
    if (a > b) return -turn(b, a, x, y);
    const area = (points[3 * a]! - x) * (points[3 * b + 1]! - y) - (points[3 * a + 1]! - y) * (points[3 * b]! - x);
    return area || Number.MIN_VALUE;
  };

  return (x, y, z) => {
    let winding = 0;
    for (const f of slices[place(x)] ?? []) {
      const [a, b, c] = [faces[f]!, faces[f + 1]!, faces[f + 2]!];
      const [p, q, r] = [turn(a, b, x, y), turn(b, c, x, y), turn(c, a, x, y)];
      if (p > 0 !== q > 0 || p > 0 !== r > 0) continue;
      const height = (points[3 * c + 2]! * p + points[3 * a + 2]! * q + points[3 * b + 2]! * r) / (p + q + r);
      if (height > z) winding += p > 0 ? 1 : -1;
    }
    return winding;
  };
}
