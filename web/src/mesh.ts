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

/** Points of the normalised frame, three coordinates each, as a mesh has them: all, or those of these numbers. */
export function placed(
  points: Float64Array,
  centre: [number, number, number],
  scale: number,
  numbers?: Int32Array,
): Pick<Mesh, "positions" | "origin"> {
  // float32 has 24 bits: up to here it rounds coordinates by less than a millionth of the shape's size.
  const isFar = centre.some((x) => Math.abs(x) > 8 * scale);
  const positions = new Float32Array(numbers ? 3 * numbers.length : points.length);
  const [x, y, z] = isFar ? [0, 0, 0] : centre;
  for (let i = 0; i < positions.length; i += 3) {
    const at = numbers ? 3 * numbers[i / 3]! : i;
    positions[i] = points[at]! * scale + x;
    positions[i + 1] = points[at + 1]! * scale + y;
    positions[i + 2] = points[at + 2]! * scale + z;
  }
  return { positions, origin: isFar ? centre : [0, 0, 0] };
}
