/** Of the last triangle that was looked at: its normal, as long as twice its area, and the dot product of its first two sides. */
export const found = new Float64Array(4);

/** Look at triangle a b c; each is the place of a first coordinate in `points`. Gives twice its area. */
export function look(points: Float64Array, a: number, b: number, c: number): number {
  const px = points[b]! - points[a]!;
  const py = points[b + 1]! - points[a + 1]!;
  const pz = points[b + 2]! - points[a + 2]!;
  const qx = points[c]! - points[a]!;
  const qy = points[c + 1]! - points[a + 1]!;
  const qz = points[c + 2]! - points[a + 2]!;
  const x = (found[0] = py * qz - pz * qy);
  const y = (found[1] = pz * qx - px * qz);
  const z = (found[2] = px * qy - py * qx);
  found[3] = px * qx + py * qy + pz * qz;
  return Math.sqrt(x * x + y * y + z * z);
}
