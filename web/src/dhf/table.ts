/** Heights of a field on a grid over its box, bilinear in between: what a mesh is made from. */
import type { Field } from "./field.js";

const BLOCK = 8; // nodes per side of a block, whose least and greatest heights are known

/** Bounds of heights over a part of the plane. */
export interface Bounds {
  nearLow: number;
  nearHigh: number;
  farLow: number;
  farHigh: number;
}

export class HeightTable {
  readonly nu: number;
  readonly nv: number;
  private readonly du: number;
  private readonly dv: number;
  /** near, far of node (i, j) at 2 (i nv + j). */
  readonly heights: Float64Array;
  private blocks: Float64Array | undefined;

  constructor(
    readonly field: Field,
    spacing: number,
    mostNodes: number,
  ) {
    const [u0, u1, v0, v1] = field.record.box as [number, number, number, number];
    const count = (size: number): number => 1 + Math.min(Math.max(Math.ceil(size / spacing), 1), mostNodes);
    this.nu = count(u1 - u0);
    this.nv = count(v1 - v0);
    this.du = (u1 - u0) / (this.nu - 1);
    this.dv = (v1 - v0) / (this.nv - 1);
    const uv = new Float64Array(2 * this.nu * this.nv);
    for (let i = 0, at = 0; i < this.nu; i++) {
      for (let j = 0; j < this.nv; j++) {
        uv[at++] = u0 + i * this.du;
        uv[at++] = v0 + j * this.dv;
      }
    }
    this.heights = field.heights(uv);
  }

  /** near (k = 0) or far (k = 1) at a point, clamped to the box. */
  height(u: number, v: number, k: number): number {
    const { box } = this.field.record;
    const { nu, nv, heights } = this;
    const x = Math.min(Math.max((u - box[0]!) / this.du, 0), nu - 1);
    const y = Math.min(Math.max((v - box[2]!) / this.dv, 0), nv - 1);
    const i = Math.min(Math.floor(x), nu - 2);
    const j = Math.min(Math.floor(y), nv - 2);
    const [s, t] = [x - i, y - j];
    const at = 2 * (i * nv + j) + k;
    const [a, b] = [heights[at]!, heights[at + 2]!];
    const [c, d] = [heights[at + 2 * nv]!, heights[at + 2 * nv + 2]!];
    return (a + (b - a) * t) * (1 - s) + (c + (d - c) * t) * s;
  }

  /** f of this field at a point of the normalised frame. */
  implicit(x: number, y: number, z: number): number {
    const { rotation: r, record } = this.field;
    const { box } = record;
    const u = r[0]! * x + r[1]! * y + r[2]! * z;
    const v = r[3]! * x + r[4]! * y + r[5]! * z;
    const w = r[6]! * x + r[7]! * y + r[8]! * z;
    const walls = Math.min(
      u - box[0]!, box[1]! - u, v - box[2]!, box[3]! - v, w - box[4]!, box[5]! - w,
    );
    return Math.min(walls, this.height(u, v, 1) - w, w - this.height(u, v, 0));
  }

  /** The outward direction of the surface at a point on it, in the normalised frame; of any length. */
  outward(x: number, y: number, z: number): [number, number, number] {
    const { rotation: r, record } = this.field;
    const { box } = record;
    const [u, v, w] = [0, 3, 6].map((k) => r[k]! * x + r[k + 1]! * y + r[k + 2]! * z) as [number, number, number];
    const terms = [
      this.height(u, v, 1) - w, w - this.height(u, v, 0),
      u - box[0]!, box[1]! - u, v - box[2]!, box[3]! - v, w - box[4]!, box[5]! - w,
    ];
    const least = terms.indexOf(Math.min(...terms));
    const n = [0, 0, 0];
    if (least < 2) {
      const sign = least ? 1 : -1;
      const [du, dv] = [this.du, this.dv];
      const k = 1 - least;
      n[0] = (sign * (this.height(u + du, v, k) - this.height(u - du, v, k))) / (2 * du);
      n[1] = (sign * (this.height(u, v + dv, k) - this.height(u, v - dv, k))) / (2 * dv);
      n[2] = -sign;
    } else n[(least - 2) >> 1] = least % 2 ? 1 : -1;
    return [0, 1, 2].map((k) => r[k]! * n[0]! + r[3 + k]! * n[1]! + r[6 + k]! * n[2]!) as [number, number, number];
  }

  /** Bounds of the heights over a rectangle, clamped to the box. */
  bounds(uLow: number, uHigh: number, vLow: number, vHigh: number): Bounds {
    const { box } = this.field.record;
    const blocks = (this.blocks ??= this.makeBlocks());
    const rows = Math.ceil(this.nv / BLOCK);
    const range = (low: number, high: number, start: number, step: number, n: number): [number, number] => {
      const clamp = (x: number): number => Math.min(Math.max((x - start) / step, 0), n - 1);
      return [Math.floor(clamp(low) / BLOCK), Math.floor(Math.ceil(clamp(high)) / BLOCK)];
    };
    const [i0, i1] = range(uLow, uHigh, box[0]!, this.du, this.nu);
    const [j0, j1] = range(vLow, vHigh, box[2]!, this.dv, this.nv);
    const out = { nearLow: Infinity, nearHigh: -Infinity, farLow: Infinity, farHigh: -Infinity };
    for (let i = i0; i <= i1; i++) {
      for (let j = j0; j <= j1; j++) {
        const at = 4 * (i * rows + j);
        out.nearLow = Math.min(out.nearLow, blocks[at]!);
        out.nearHigh = Math.max(out.nearHigh, blocks[at + 1]!);
        out.farLow = Math.min(out.farLow, blocks[at + 2]!);
        out.farHigh = Math.max(out.farHigh, blocks[at + 3]!);
      }
    }
    return out;
  }

  /** Least and greatest near and far of each block of nodes. */
  private makeBlocks(): Float64Array {
    const { nu, nv, heights } = this;
    const rows = Math.ceil(nv / BLOCK);
    const out = new Float64Array(4 * Math.ceil(nu / BLOCK) * rows);
    for (let k = 0; k < out.length; k++) out[k] = k % 2 ? -Infinity : Infinity;
    for (let i = 0; i < nu; i++) {
      for (let j = 0; j < nv; j++) {
        const at = 4 * (Math.floor(i / BLOCK) * rows + Math.floor(j / BLOCK));
        const [near, far] = [heights[2 * (i * nv + j)]!, heights[2 * (i * nv + j) + 1]!];
        out[at] = Math.min(out[at]!, near);
        out[at + 1] = Math.max(out[at + 1]!, near);
        out[at + 2] = Math.min(out[at + 2]!, far);
        out[at + 3] = Math.max(out[at + 3]!, far);
      }
    }
    return out;
  }

  /** The box, u min, u max, ..., z max, of the nodes where there is something; null where there is nothing. */
  solidBox(): number[] | null {
    const { box } = this.field.record;
    const out = [Infinity, -Infinity, Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i < this.nu; i++) {
      for (let j = 0; j < this.nv; j++) {
        const at = 2 * (i * this.nv + j);
        const [near, far] = [Math.max(this.heights[at]!, box[4]!), Math.min(this.heights[at + 1]!, box[5]!)];
        if (far < near) continue;
        const [u, v] = [box[0]! + i * this.du, box[2]! + j * this.dv];
        [u - this.du, u + this.du, v - this.dv, v + this.dv, near, far].forEach((x, k) => {
          out[k] = k % 2 ? Math.max(out[k]!, x) : Math.min(out[k]!, x);
        });
      }
    }
    return out[0]! < out[1]! ? out : null;
  }
}
