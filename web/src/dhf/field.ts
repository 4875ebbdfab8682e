/** One double height field: spec/cndhf.md, section 6.1. */
import { rotationMatrix } from "../rotation.js";
import { networkOf } from "./network.js";
import type { DhfRecord } from "./records.js";

export class Field {
  /** Takes the normalised frame to (u, v, z), row by row. */
  declare readonly rotation: number[];
  private declare readonly network: (uv: Float64Array) => Float64Array;

  constructor(
    readonly record: DhfRecord,
    /** The weights, in file order: W0, b0, W1, b1, ... */
    readonly tensors: Float32Array[],
  ) {
    this.rotation = rotationMatrix(record.quaternion);
    this.network = networkOf(tensors, record.omegaFirst, record.omegaHidden);
  }

  /** Near and far heights of points (u, v, u, v, ...), clamped to the box and folded. */
  heights(uv: ArrayLike<number>): Float64Array {
    const { box, fold } = this.record;
    const inputs = Float64Array.from(uv, (x, i) => {
      const k = i & 1;
      const [low, high] = [box[2 * k]!, box[2 * k + 1]!];
      const middle = (low + high) / 2;
      const clamped = Math.min(Math.max(x, low), high);
      return (fold >> k) & 1 ? middle + Math.abs(clamped - middle) : clamped;
    });
    return this.network(inputs);
  }

  /** f of this field at points (x, y, z, ...) of the normalised frame. */
  implicit(points: Float64Array): Float64Array {
    const { rotation: r, record: { box } } = this;
    const uvz = points.map((_, i) => {
      const row = 3 * (i % 3);
      const at = i - (i % 3);
      return r[row]! * points[at]! + r[row + 1]! * points[at + 1]! + r[row + 2]! * points[at + 2]!;
    });
    const heights = this.heights(uvz.filter((_, i) => i % 3 < 2));
    return new Float64Array(points.length / 3).map((_, i) => {
      const [u, v, z] = [uvz[3 * i]!, uvz[3 * i + 1]!, uvz[3 * i + 2]!];
      return Math.min(
        heights[2 * i + 1]! - z, z - heights[2 * i]!,
        u - box[0]!, box[1]! - u, v - box[2]!, box[3]! - v, z - box[4]!, box[5]! - z,
      );
    });
  }
}
