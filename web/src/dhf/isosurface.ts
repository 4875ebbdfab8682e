/** The surface f = 0 of an intersection of fields, by marching cubes on height tables. */
import { cases } from "./cases.js";
import type { Field } from "./field.js";
import { HeightTable } from "./table.js";

const BRICK = 8; // cells per side; bricks without surface are left out by the bounds of their heights
const NODES = BRICK + 1;
const COARSE = 32; // cells per side of the tables that find the solid's box
const MAX_WORK = 2 ** 33; // products of all tables together: some seconds
const MAX_VERTICES = 2 ** 22;
const SECANT_STEPS = 4;
const CLEARANCE = 1e-3; // in spacings: the least distance of a vertex from a node

/** Points and unit normals in the normalised frame, three numbers each, and triangles. */
export interface Isosurface {
  points: Float64Array;
  normals: Float32Array;
  index: Uint32Array;
}

/** Why there is no surface. This file stands alone, so that loading it is one request. */
export class NoSurfaceError extends Error {}

/** `resolution`: cells along the longest side of the solid. Throws NoSurfaceError. */
export function isosurface(fields: Field[], resolution: number): Isosurface {
  const weights = fields.reduce((sum, { record }) => sum + record.sizes.reduce((a, b) => a + b), 0);
  if (weights * resolution ** 2 > MAX_WORK) {
    throw new NoSurfaceError(`this file asks for too much work at resolution ${resolution}: lower it`);
  }
  const tabulated = (spacing: (field: Field) => number): HeightTable[] =>
    fields.map((field) => new HeightTable(field, spacing(field), 2 * resolution));
  const coarse = solidBox(tabulated(({ record: { box } }) => Math.max(box[1]! - box[0]!, box[3]! - box[2]!) / COARSE));
  // Half a cell less, so that no node falls on the planes that bound the solid.
  const spacing = longest(coarse) / (resolution - 0.5);
  if (!(spacing > 0)) throw new NoSurfaceError("the solid is empty");
  const tables = tabulated(() => spacing);
  const [low, high] = solidBox(tables);
  return new Grid(tables, low, high, spacing).march();
}

type Box = [number[], number[]];

const longest = ([low, high]: Box): number => Math.max(...high.map((x, k) => x - low[k]!));

/** A box around the solid in the normalised frame: the intersection of the boxes of the fields' own solids. */
function solidBox(tables: HeightTable[]): Box {
  const low = [-Infinity, -Infinity, -Infinity];
  const high = [Infinity, Infinity, Infinity];
  for (const table of tables) {
    const box = table.solidBox();
    if (!box) throw new NoSurfaceError("the solid is empty at this resolution; raise it");
    const r = table.field.rotation;
    for (let k = 0; k < 3; k++) {
      const corners = Array.from({ length: 8 }, (_, c) => r[k]! * box[c & 1]! + r[3 + k]! * box[2 + ((c >> 1) & 1)]! +
        r[6 + k]! * box[4 + (c >> 2)]!);
      low[k] = Math.max(low[k]!, Math.min(...corners));
      high[k] = Math.min(high[k]!, Math.max(...corners));
    }
  }
  if (low.some((x, k) => x >= high[k]!)) {
    throw new NoSurfaceError("the solid is empty: its double height fields do not meet");
  }
  return [low, high];
}

class Grid {
  private readonly shape: number[]; // in bricks
  private readonly origin: number[];
  private readonly points: number[] = [];
  private readonly index: number[] = [];
  private readonly vertices = new Map<number, number>(); // of the grid's edges that the surface crosses
  private readonly values = new Float64Array(NODES ** 3); // f at the nodes of a brick

  constructor(
    private readonly tables: HeightTable[],
    low: number[],
    high: number[],
    private readonly spacing: number,
  ) {
    this.shape = low.map((x, k) => Math.ceil(((high[k]! - x) / spacing + 2) / BRICK));
    this.origin = low.map((x, k) => (x + high[k]! - this.shape[k]! * BRICK * spacing) / 2);
  }

  march(): Isosurface {
    const [nx, ny, nz] = this.shape as [number, number, number];
    for (let i = 0; i < nx; i++) {
      for (let j = 0; j < ny; j++) {
        for (let k = 0; k < nz; k++) this.brick([i * BRICK, j * BRICK, k * BRICK]);
      }
    }
    if (!this.index.length) {
      throw new NoSurfaceError("the solid is empty or thinner than a cell; raise the resolution");
    }
    const points = Float64Array.from(this.points);
    return { points, normals: this.normals(points), index: Uint32Array.from(this.index) };
  }

  /** The triangles in the cells of the brick whose first node is `at`. */
  private brick(at: number[]): void {
    const tables = this.crossing(at);
    if (!tables.length) return;
    const { values } = this;
    const [x, y, z] = [0, 1, 2].map((k) =>
      Float64Array.from({ length: NODES }, (_, i) => this.origin[k]! + this.spacing * (at[k]! + i)),
    ) as [Float64Array, Float64Array, Float64Array];
    let n = 0;
    for (let i = 0; i < NODES; i++) {
      for (let j = 0; j < NODES; j++) {
        for (let k = 0; k < NODES; k++) {
          let f = Infinity;
          for (const table of tables) f = Math.min(f, table.implicit(x[i]!, y[j]!, z[k]!));
          values[n++] = f;
        }
      }
    }
    const table = cases();
    for (let i = 0; i < BRICK; i++) {
      for (let j = 0; j < BRICK; j++) {
        for (let k = 0; k < BRICK; k++) {
          const first = (i * NODES + j) * NODES + k;
          let inside = 0;
          for (let c = 0; c < 8; c++) if (values[first + STRIDES[c]!]! >= 0) inside |= 1 << c;
          if (inside === 0 || inside === 255) continue;
          for (const edge of table[inside]!) {
            const c = Math.floor(edge / 3);
            const node = [at[0]! + i + (c >> 2), at[1]! + j + ((c >> 1) & 1), at[2]! + k + (c & 1)];
            const from = first + STRIDES[c]!;
            const to = from + STRIDES[4 >> edge % 3]!;
            this.index.push(this.vertex(node, edge % 3, values[from]!, values[to]!));
          }
        }
      }
    }
  }

  /** The tables whose f is not positive in all of a brick; none where one is negative in all of it. */
  private crossing(at: number[]): HeightTable[] {
    const out: HeightTable[] = [];
    const half = (this.spacing * BRICK) / 2;
    const centre = at.map((i, k) => this.origin[k]! + this.spacing * i + half);
    for (const table of this.tables) {
      const { rotation: r, record } = table.field;
      const { box } = record;
      const [low, high]: Box = [[], []];
      for (let k = 0; k < 3; k++) {
        const row = r.slice(3 * k, 3 * k + 3);
        const middle = row[0]! * centre[0]! + row[1]! * centre[1]! + row[2]! * centre[2]!;
        // A little more than the brick: nodes are computed with rounding.
        const reach = half * (1 + 1e-9) * (Math.abs(row[0]!) + Math.abs(row[1]!) + Math.abs(row[2]!)) + 1e-12;
        low.push(middle - reach);
        high.push(middle + reach);
      }
      const b = table.bounds(low[0]!, high[0]!, low[1]!, high[1]!);
      const most = Math.min(
        b.farHigh - low[2]!, high[2]! - b.nearLow, ...high.map((x, k) => x - box[2 * k]!),
        ...low.map((x, k) => box[2 * k + 1]! - x),
      );
      if (most < 0) return [];
      const least = Math.min(
        b.farLow - high[2]!, low[2]! - b.nearHigh, ...low.map((x, k) => x - box[2 * k]!),
        ...high.map((x, k) => box[2 * k + 1]! - x),
      );
      if (!(least > 0)) out.push(table);
    }
    return out;
  }

  /** The vertex on the edge from a node along an axis, where f is `a` and `b` at its ends. */
  private vertex(node: number[], axis: number, a: number, b: number): number {
    const [ny, nz] = [this.shape[1]! * BRICK + 1, this.shape[2]! * BRICK + 1];
    const key = 3 * ((node[0]! * ny + node[1]!) * nz + node[2]!) + axis;
    let number = this.vertices.get(key);
    if (number !== undefined) return number;
    number = this.vertices.size;
    if (number === MAX_VERTICES) {
      throw new NoSurfaceError(`the mesh has more than ${MAX_VERTICES} vertices; lower the resolution`);
    }
    this.vertices.set(key, number);
    const point = node.map((i, k) => this.origin[k]! + this.spacing * i);
    const start = point[axis]!;
    // Secants in a bracket (the Illinois method): across creases f is not linear along the edge.
    let [s, t, kept] = [0, 1, 0];
    let root = 0.5;
    for (let step = 0; step < SECANT_STEPS && a !== b; step++) {
      root = (s * b - t * a) / (b - a);
      point[axis] = start + this.spacing * root;
      const f = this.implicit(point);
      if (f >= 0 === a >= 0) {
        [s, a] = [root, f];
        if (kept === 1) b /= 2;
        kept = 1;
      } else {
        [t, b] = [root, f];
        if (kept === 2) a /= 2;
        kept = 2;
      }
    }
    point[axis] = start + this.spacing * Math.min(Math.max(root, CLEARANCE), 1 - CLEARANCE);
    this.points.push(point[0]!, point[1]!, point[2]!);
    return number;
  }

  private implicit(p: number[]): number {
    let f = Infinity;
    for (const table of this.tables) f = Math.min(f, table.implicit(p[0]!, p[1]!, p[2]!));
    return f;
  }

  /** Unit normals of the field whose surface each point lies on. */
  private normals(points: Float64Array): Float32Array {
    const out = new Float32Array(points.length);
    for (let i = 0; i < points.length; i += 3) {
      const [x, y, z] = [points[i]!, points[i + 1]!, points[i + 2]!];
      let least = this.tables[0]!;
      let f = Infinity;
      for (const table of this.tables) {
        const value = table.implicit(x, y, z);
        if (value < f) [least, f] = [table, value];
      }
      const n = least.outward(x, y, z);
      const length = Math.hypot(...n) || 1;
      for (let k = 0; k < 3; k++) out[i + k] = n[k]! / length;
    }
    return out;
  }
}

/** From the first node of a cell to its corner c, in the nodes of a brick. */
const STRIDES = Array.from({ length: 8 }, (_, c) => ((c >> 2) * NODES + ((c >> 1) & 1)) * NODES + (c & 1));
