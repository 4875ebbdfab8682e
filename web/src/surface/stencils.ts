/** Limit points and normals as sums of vertices by weights: spec/cndhf.md, section 6.2. */
import { beta } from "./subdivision.js";

/** Kinds of sectors, by their weights. Normals of the last two wait; the point of the last one is known. */
export const SMOOTH = 0;
export const DART = 1;
export const CREASE = 2;
export const CORNER = 3;
export const NONE = 4;

const ENOUGH = 2 ** 16; // numbers that are kept until they are evaluated

/**
 * A list of whole numbers says which vertices make which sector, and one loop makes all points and normals of it: a
 * program that runs once is compiled late, and until then numbers that are not whole are slow.
 */
export class Stencils {
  // For each sector: its number, where its weights start, how many neighbours have one (-1: the point is known), and how
  // many triangles it has, negative where they are turned; then the vertex and its neighbours.
  private readonly list: number[] = [];
  private end = 0;
  private readonly weights: number[] = []; // three per neighbour: in the point, and in two tangents
  private readonly tables: number[] = [];
  // Sectors whose normals wait for the points around them, as in `list`, without weights and without their own vertex.
  private readonly waiting: number[] = [];

  constructor(
    private readonly vertices: Float64Array,
    private readonly points: Float64Array,
    private readonly normals: Float32Array,
  ) {}

  /** Begin a sector of vertex v with n triangles; its n + 1 neighbours follow. `isTurned` says that they are clockwise. */
  begin(sector: number, kind: number, n: number, isTurned: boolean, v: number): void {
    if (this.end > ENOUGH) this.evaluate();
    const { list, end } = this;
    list[end] = sector;
    list[end + 1] = kind < CORNER ? (this.tables[3 * n + kind] ??= this.table(kind, n)) : 0;
    list[end + 2] = kind < CREASE ? n : kind === CREASE ? n + 1 : CORNER - kind;
    list[end + 3] = isTurned ? -n : n;
    list[end + 4] = v;
    this.end = end + 5;
  }

  put(v: number): void {
    this.list[this.end++] = v;
  }

  /** Set all points and normals of what has been put. */
  finish(): void {
    this.evaluate();
    for (let i = 0; i < this.waiting.length; ) i = this.setByAngles(i);
  }

  private table(kind: number, n: number): number {
    const { weights } = this;
    const at = weights.length;
    const put = (...row: number[]): number => weights.push(...row);
    if (kind === CREASE) {
      // The tangents along the crease, and across it (Hoppe et al. 1994); of a single face, both arms count alike.
      const x = Math.PI / n;
      const end = n === 1 ? 1 : -Math.cos(x) / Math.tan(x / 2) / (1 + 2 * Math.cos(x));
      for (let i = 0; i <= n; i++) {
        if (i % n) put(0, 0, Math.sin(i * x));
        else put(1 / 6, i ? -1 : 1, end);
      }
      return at;
    }
    const b = (8 / 3) * beta(n);
    const r = (5 - Math.sqrt(21)) / 2;
    const dart = (i: number): number => b * (1 - (r ** i + r ** (n - i)) / (1 + r ** n));
    let sum = 1;
    for (let i = 0; i < n; i++) {
      const angle = (2 * Math.PI * i) / n; // Loop's tangents
      const share = kind === SMOOTH ? b : i ? dart(i) : (3 / 4) * b + (dart(1) + dart(n - 1)) / 4;
      put(share, Math.cos(angle), Math.sin(angle));
      sum += share;
    }
    for (let i = at; i < weights.length; i += 3) weights[i]! /= sum;
    return at;
  }

  private evaluate(): void {
    const { list, end, weights, vertices, points, normals, waiting } = this;
    this.end = 0;
    for (let i = 0; i < end; ) {
      const at = 3 * list[i]!;
      let t = list[i + 1]!;
      const rows = list[i + 2]!;
      const turns = list[i + 3]!;
      i += 4;
      const own = 3 * list[i]!;
      const ox = vertices[own]!;
      const oy = vertices[own + 1]!;
      const oz = vertices[own + 2]!;
      let px = ox, py = oy, pz = oz, ux = 0, uy = 0, uz = 0, wx = 0, wy = 0, wz = 0;
      for (let j = i + 1; j <= i + rows; j++) {
        const v = 3 * list[j]!;
        const x = vertices[v]! - ox; // so that what should be 0 is exactly 0
        const y = vertices[v + 1]! - oy;
        const z = vertices[v + 2]! - oz;
        const p = weights[t]!;
        const u = weights[t + 1]!;
        const w = weights[t + 2]!;
        t += 3;
        px += p * x;
        py += p * y;
        pz += p * z;
        ux += u * x;
        uy += u * y;
        uz += u * z;
        wx += w * x;
        wy += w * y;
        wz += w * z;
      }
      if (rows >= 0) {
        points[at] = px;
        points[at + 1] = py;
        points[at + 2] = pz;
      }
      const next = i + 2 + Math.abs(turns);
      if (!unit(normals, at, uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx, turns)) {
        waiting.push(at, turns, ...list.slice(i + 1, next));
      }
      i = next;
    }
  }

  /** Set the normal that waits at i: the unit normals of the triangles by their angles. Gives the place of the next. */
  private setByAngles(i: number): number {
    const { points, normals, waiting } = this;
    const at = waiting[i]!;
    const turns = waiting[i + 1]!;
    const end = i + 3 + Math.abs(turns);
    let x = 0, y = 0, z = 0, ax = 0, ay = 0, az = 0;
    for (let j = i + 2; j < end; j++) {
      const p = 3 * waiting[j]!;
      const bx = points[p]! - points[at]!;
      const by = points[p + 1]! - points[at + 1]!;
      const bz = points[p + 2]! - points[at + 2]!;
      const cx = ay * bz - az * by;
      const cy = az * bx - ax * bz;
      const cz = ax * by - ay * bx;
      const area = Math.sqrt(cx * cx + cy * cy + cz * cz);
      const share = area && Math.atan2(area, ax * bx + ay * by + az * bz) / area;
      x += share * cx;
      y += share * cy;
      z += share * cz;
      ax = bx;
      ay = by;
      az = bz;
    }
    unit(normals, at, x, y, z, turns);
    return end;
  }
}

/** Set a vector (x, y, z) at length one, turned for negative `turns`; zero stays zero. Gives the length that it had. */
function unit(out: Float32Array, at: number, x: number, y: number, z: number, turns: number): number {
  const length = Math.sqrt(x * x + y * y + z * z);
  const divisor = (length || 1) * Math.sign(turns);
  out[at] = x / divisor;
  out[at + 1] = y / divisor;
  out[at + 2] = z / divisor;
  return length;
}
