/** Of the triangle that was measured last: its normal, as long as twice its area, and the dot product of sides a b and a c. */
export const measured = new Float64Array(4);

/** Measure triangle a b c; each is the place of a first coordinate in `points`. Gives twice its area. */
export function measure(points: Float64Array, a: number, b: number, c: number): number {
  const px = points[b]! - points[a]!;
  const py = points[b + 1]! - points[a + 1]!;
  const pz = points[b + 2]! - points[a + 2]!;
  const qx = points[c]! - points[a]!;
  const qy = points[c + 1]! - points[a + 1]!;
  const qz = points[c + 2]! - points[a + 2]!;
  const x = (measured[0] = py * qz - pz * qy);
  const y = (measured[1] = pz * qx - px * qz);
  const z = (measured[2] = px * qy - py * qx);
  measured[3] = px * qx + py * qy + pz * qz;
  return Math.sqrt(x * x + y * y + z * z);
}
