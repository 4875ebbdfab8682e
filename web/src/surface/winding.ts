/** Winding numbers of a closed triangle mesh, by rays along +z and a grid of their starts in x and y. */

export class WindingNumbers {
  private readonly low = [0, 0];
  private readonly cell: number;
  private readonly side: number;
  /** Of each cell, the triangles whose box meets it, from first[cell] to first[cell + 1]. */
  private readonly first: Int32Array;
  private readonly triangles: Int32Array;

  constructor(
    private readonly points: Float64Array,
    private readonly faces: Int32Array,
  ) {
    const high = [-Infinity, -Infinity];
    this.low = [Infinity, Infinity];
    for (let i = 0; i < points.length; i++) {
      if (i % 3 === 2) continue;
      this.low[i % 3] = Math.min(this.low[i % 3]!, points[i]!);
      high[i % 3] = Math.max(high[i % 3]!, points[i]!);
    }
    // About one triangle of each side of the solid per cell.
    this.side = Math.max(1, Math.ceil(Math.sqrt(faces.length / 6)));
    this.cell = Math.max(high[0]! - this.low[0]!, high[1]! - this.low[1]!) / this.side || 1;
    this.first = new Int32Array(this.side ** 2 + 1);
    this.eachCell((cell) => this.first[cell + 1]!++);
    for (let k = 0; k < this.side ** 2; k++) this.first[k + 1]! += this.first[k]!;
    this.triangles = new Int32Array(this.first[this.side ** 2]!);
    const at = this.first.slice();
    this.eachCell((cell, face) => (this.triangles[at[cell]!++] = face));
  }

  /** How often the mesh winds round a point. */
  at(x: number, y: number, z: number): number {
    const { points, faces, side } = this;
    const [i, j] = [(x - this.low[0]!) / this.cell, (y - this.low[1]!) / this.cell];
    if (!(i >= 0 && j >= 0 && i <= side && j <= side)) return 0;
    const cell = this.number(i) * side + this.number(j);
    let winding = 0;
    for (let k = this.first[cell]!; k < this.first[cell + 1]!; k++) {
      const f = 3 * this.triangles[k]!;
      const [a, b, c] = [faces[f]!, faces[f + 1]!, faces[f + 2]!];
      const [p, q, r] = [this.turn(a, b, x, y), this.turn(b, c, x, y), this.turn(c, a, x, y)];
      if (p > 0 !== q > 0 || p > 0 !== r > 0) continue;
      const height = (points[3 * c + 2]! * p + points[3 * a + 2]! * q + points[3 * b + 2]! * r) / (p + q + r);
      if (height > z) winding += p > 0 ? 1 : -1;
    }
    return winding;
  }

  /** Twice the area of (x, y) and an edge. Exactly opposite from its other side; a zero counts as beside the edge. */
  private turn(a: number, b: number, x: number, y: number): number {
    if (a > b) return -this.turn(b, a, x, y);
    const { points } = this;
    const [ax, ay] = [points[3 * a]! - x, points[3 * a + 1]! - y];
    const [bx, by] = [points[3 * b]! - x, points[3 * b + 1]! - y];
    return ax * by - ay * bx || Number.MIN_VALUE;
  }

  private number(x: number): number {
    return Math.min(Math.max(Math.floor(x), 0), this.side - 1);
  }

  private eachCell(visit: (cell: number, face: number) => void): void {
    const { points, faces, low, cell, side } = this;
    for (let f = 0; f < faces.length; f += 3) {
      const range = [0, 1].map((k) => {
        const x = [0, 1, 2].map((i) => (points[3 * faces[f + i]! + k]! - low[k]!) / cell);
        return [this.number(Math.min(...x)), this.number(Math.max(...x))] as const;
      });
      for (let i = range[0]![0]; i <= range[0]![1]; i++) {
        for (let j = range[1]![0]; j <= range[1]![1]; j++) visit(i * side + j, f / 3);
      }
    }
  }
}
