/** Distances from the triangles of a mesh, by a grid of cells. */
import { Triangle, Vector3 } from "three";

export class NearestTriangle {
  private readonly cells = new Map<number, number[]>();
  private readonly low: Vector3;
  private readonly size: number;
  private readonly side = 256;

  constructor(
    private readonly positions: ArrayLike<number>,
    private readonly index: ArrayLike<number>,
    low: Vector3,
    high: Vector3,
  ) {
    this.low = low;
    const n = index.length / 3;
    const sides = high.clone().sub(low);
    const longest = Math.max(sides.x, sides.y, sides.z) || 1;
    this.size = longest / Math.min(this.side - 2, Math.max(4, Math.ceil(Math.sqrt(n / 2))));
    for (let f = 0; f < n; f++) {
      const [from, to] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
      for (let k = 0; k < 3; k++) {
        for (let j = 0; j < 3; j++) {
          const x = this.cell(positions[3 * index[3 * f + k]! + j]!, j);
          from[j] = Math.min(from[j]!, x);
          to[j] = Math.max(to[j]!, x);
        }
      }
      for (let x = from[0]!; x <= to[0]!; x++) {
        for (let y = from[1]!; y <= to[1]!; y++) {
          for (let z = from[2]!; z <= to[2]!; z++) {
            const key = (x * this.side + y) * this.side + z;
            const found = this.cells.get(key);
            if (found) found.push(f);
            else this.cells.set(key, [f]);
          }
        }
      }
    }
  }

  /** The distance of a point, at most `most`. */
  distance(point: Vector3, most: number): number {
    const at = point.toArray().map((x, k) => this.cell(x, k));
    const triangle = new Triangle();
    const nearest = new Vector3();
    let best = most;
    for (let ring = 0; (ring - 1) * this.size < best && ring < this.side; ring++) {
      for (let x = -ring; x <= ring; x++) {
        for (let y = -ring; y <= ring; y++) {
          const step = Math.max(Math.abs(x), Math.abs(y)) === ring ? 1 : 2 * ring || 1;
          for (let z = -ring; z <= ring; z += step) {
            const key = ((at[0]! + x) * this.side + at[1]! + y) * this.side + at[2]! + z;
            for (const f of this.cells.get(key) ?? []) {
              const corner = (k: number, v: Vector3): Vector3 => v.fromArray(this.positions, 3 * this.index[3 * f + k]!);
              corner(0, triangle.a);
              corner(1, triangle.b);
              corner(2, triangle.c);
              triangle.closestPointToPoint(point, nearest);
              best = Math.min(best, nearest.distanceTo(point));
            }
          }
        }
      }
    }
    return best;
  }

  private cell(x: number, k: number): number {
    return 1 + Math.min(Math.max(Math.floor((x - this.low.getComponent(k)) / this.size), -1), this.side - 2);
  }
}
