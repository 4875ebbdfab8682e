/** Winding numbers of a closed triangle mesh, by rays along +z and a grid of their starts in x and y. */

/** How often a mesh winds round a point (x, y, z), as a function. Three numbers per point, three vertices per face. */
export function windingNumber(points: Float64Array, faces: Uint32Array): (x: number, y: number, z: number) => number {
  const low = [Infinity, Infinity];
  const high = [-Infinity, -Infinity];
  for (let i = 0; i < points.length; i++) {
    const k = i % 3;
    if (k === 2) continue;
    low[k] = Math.min(low[k]!, points[i]!);
    high[k] = Math.max(high[k]!, points[i]!);
  }
  // About one triangle of each side of the solid per cell.
  const side = Math.max(1, Math.ceil(Math.sqrt(faces.length / 6)));
  const size = Math.max(high[0]! - low[0]!, high[1]! - low[1]!) / side || 1;
  const place = (x: number, k: number): number =>
    Math.min(Math.max(Math.floor((x - low[k]!) / size), 0), side - 1);
  const cells: number[][] = Array.from({ length: side * side }, () => []); // faces whose box meets them
  for (let f = 0; f < faces.length; f += 3) {
    const [i0, i1, j0, j1] = [0, 1].flatMap((k) => {
      const x = [0, 1, 2].map((i) => place(points[3 * faces[f + i]! + k]!, k));
      return [Math.min(...x), Math.max(...x)];
    }) as [number, number, number, number];
    for (let i = i0; i <= i1; i++) for (let j = j0; j <= j1; j++) cells[i * side + j]!.push(f);
  }

  /** Twice the area of (x, y) and an edge. Exactly opposite from its other side; a zero counts as beside the edge. */
  const turn = (a: number, b: number, x: number, y: number): number => {
    if (a > b) return -turn(b, a, x, y);
    const [ax, ay] = [points[3 * a]! - x, points[3 * a + 1]! - y];
    const [bx, by] = [points[3 * b]! - x, points[3 * b + 1]! - y];
    return ax * by - ay * bx || Number.MIN_VALUE;
  };

  return (x, y, z) => {
    let winding = 0;
    if (!(x >= low[0]! && x <= high[0]! && y >= low[1]! && y <= high[1]!)) return winding;
    for (const f of cells[place(x, 0) * side + place(y, 1)]!) {
      const [a, b, c] = [faces[f]!, faces[f + 1]!, faces[f + 2]!];
      const [p, q, r] = [turn(a, b, x, y), turn(b, c, x, y), turn(c, a, x, y)];
      if (p > 0 !== q > 0 || p > 0 !== r > 0) continue;
      const height = (points[3 * c + 2]! * p + points[3 * a + 2]! * q + points[3 * b + 2]! * r) / (p + q + r);
      if (height > z) winding += p > 0 ? 1 : -1;
    }
    return winding;
  };
}
