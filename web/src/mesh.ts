/** A triangle mesh in typed arrays, ready for a graphics card. */
export interface Mesh {
  /** Three coordinates per vertex, in input units; add `origin` for input coordinates. */
  positions: Float32Array;
  /** Unit normals of the exact surface, outward where it has an inside. */
  normals: Float32Array;
  /** Three vertices per triangle, anticlockwise seen from outside. */
  index: Uint32Array;
  /** Zero, but for a shape so far from the origin that float32 would round its coordinates: then the shape's centre. */
  origin: [number, number, number];
}

/** Where input coordinates are measured from: coordinates are rounded by less than a millionth of the shape's size. */
export function originOf(centre: [number, number, number], scale: number): [number, number, number] {
  const far = centre.some((x) => Math.abs(x) > 8 * scale); // float32 has 24 bits; 2^-24 of 8 scales is 5e-7 of one
  return far ? centre : [0, 0, 0];
}

/** Points of the normalised frame (N, 3) as float32 in input units from `origin`. */
export function placed(
  points: Float64Array,
  centre: [number, number, number],
  scale: number,
  origin: [number, number, number],
): Float32Array {
  return Float32Array.from(points, (x, i) => x * scale + (centre[i % 3]! - origin[i % 3]!));
}
