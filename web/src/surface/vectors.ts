/** Vectors of three coordinates that are used again and again, so that nothing is allocated per vector. */
export const u = new Float64Array(3);
export const v = new Float64Array(3);
export const w = new Float64Array(3);

/** Set a vector to that from one point to another; each is the place of its first coordinate in `points`. */
export function arm(out: Float64Array, points: Float64Array, from: number, to: number): void {
  out[0] = points[to]! - points[from]!;
  out[1] = points[to + 1]! - points[from + 1]!;
  out[2] = points[to + 2]! - points[from + 2]!;
}

export const dot = (a: Float64Array, b: Float64Array): number => a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;

/** Set w to the cross product of u and v. Gives its length. */
export function cross(): number {
  w[0] = u[1]! * v[2]! - u[2]! * v[1]!;
  w[1] = u[2]! * v[0]! - u[0]! * v[2]!;
  w[2] = u[0]! * v[1]! - u[1]! * v[0]!;
  return Math.sqrt(dot(w, w));
}
