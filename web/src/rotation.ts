/** The rotation matrix of an integer quaternion x, y, z, w, row by row: spec/cndhf.md, section 6.1. */
export function rotationMatrix([x, y, z, w]: number[] | Int16Array): number[] {
  const [a, b, c, d] = [x! * x!, y! * y!, z! * z!, w! * w!];
  const n = a + b + c + d;
  return [
    a - b - c + d, 2 * (x! * y! - z! * w!), 2 * (x! * z! + y! * w!),
    2 * (x! * y! + z! * w!), b - a - c + d, 2 * (y! * z! - x! * w!),
    2 * (x! * z! - y! * w!), 2 * (y! * z! + x! * w!), c - a - b + d,
  ].map((m) => m / n);
}
