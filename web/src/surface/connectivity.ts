/** The faces of a control mesh: spec/cndhf.md, section 4.3, whose names these are. */
import { LimitError, PayloadError } from "../errors.js";
import { UnsignedModel } from "./models.js";
import { Queue } from "./queue.js";
import { type RangeDecoder, closing, Context, contexts } from "./rangeCoder.js";

const MAX_VERTICES = 2 ** 17;
const MAX_FACES = 2 ** 18;
const FREE_FACES = 2 ** 16;
const FACES_PER_BYTE = 256;
const LEVELS = 6; // queues of pivots
const DEGREES = 10;
const MAX_STEPS = 64;
const PIVOT_CLOSES = [1, 1, 25, 8, 22, 36, 42, 40, 33, 15];
const OTHER_CLOSES = [1, 1, 2, 6, 18, 30, 35, 37, 37, 32];

/** Vertex numbers of all faces, three per face, each with its least number first. `sectionSize` limits their number. */
export function decodeConnectivity(coder: RangeDecoder, sectionSize: number): Int32Array {
  const oriented = coder.bit(new Context());
  const walk = new Walk(coder, !!oriented, Math.min(MAX_FACES, FREE_FACES + FACES_PER_BYTE * sectionSize));
  walk.run();
  const walked = walk.faces();
  if (!oriented) turn(coder, walked);
  const numbers = new Map<number, number>();
  const faces = Int32Array.from(walked, (v) => {
    let number = numbers.get(v);
    if (number === undefined) numbers.set(v, (number = numbers.size));
    return number;
  });
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = faces.subarray(f, f + 3) as unknown as [number, number, number];
    faces.set(b < a && b < c ? [b, c, a] : c < a && c < b ? [c, a, b] : [a, b, c], f);
  }
  return faces;
}

/** Turn round the faces that say so. */
function turn(coder: RangeDecoder, faces: number[]): void {
  const marks = contexts(2);
  let last = 0;
  for (let f = 0; f < faces.length; f += 3) {
    last = coder.bit(marks[last]!);
    if (last) [faces[f + 1], faces[f + 2]] = [faces[f + 2]!, faces[f + 1]!];
  }
}

class Walk {
  private readonly out: number[] = [];
  // Of nodes.
  private readonly prev: number[] = [];
  private readonly next: number[] = [];
  private readonly vertex: number[] = [];
  private readonly dropped: boolean[] = [];
  // Of vertices.
  private readonly degree: number[] = [];
  private readonly isCap: boolean[] = [];
  private readonly capped: boolean[] = [];

  private readonly queues = Array.from({ length: LEVELS }, () => new Queue());
  private readonly another = new Context(); // G
  private readonly pivotCloses = [0, 1, 2].map(() => PIVOT_CLOSES.map(closing)); // A
  private readonly otherCloses = OTHER_CLOSES.map(closing); // O
  private readonly joins = closing(2); // J
  private readonly far = closing(5); // F
  private readonly caps = new Context(); // K
  private readonly side = new Context(); // H
  private readonly twisted = new Context(); // T
  private readonly steps = new UnsignedModel(); // W
  private hasCaps = false;

  constructor(
    private readonly coder: RangeDecoder,
    private readonly oriented: boolean,
    private readonly maxFaces: number,
  ) {}

  /** The faces so far, without those of caps. */
  faces(): number[] {
    const { out, isCap } = this;
    return out.filter((_, i) => {
      const f = i - (i % 3);
      return !(isCap[out[f]!] || isCap[out[f + 1]!] || isCap[out[f + 2]!]);
    });
  }

  run(): void {
    this.hasCaps = !!this.coder.bit(new Context());
    while (this.coder.bit(this.another)) {
      const [a, b, c] = [this.addVertex(false), this.addVertex(false), this.addVertex(false)] as const;
      this.addFace(a, b, c);
      // The border runs the other way round than the face, as the next faces do.
      const n = this.vertex.length;
      this.addNode(a, n + 2, n + 1);
      this.addNode(c, n, n + 2);
      this.addNode(b, n + 1, n);
      for (let k = 0; k < 3; k++) this.push(n + k);
      for (let pivot = this.pop(); pivot >= 0; pivot = this.pop()) {
        while (!this.dropped[pivot]) this.grow(pivot);
      }
    }
  }

  private grow(P: number): void {
    const { coder, vertex, degree, capped, isCap } = this;
    let [Q, R] = [this.next[P]!, this.prev[P]!];
    const ahead = degree[vertex[Q]!]! >= degree[vertex[R]!]!;
    if (!ahead) [Q, R] = [R, Q];
    const S = this.other(Q, P);
    const [p, q] = [vertex[P]!, vertex[Q]!];
    const kind = isCap[p] ? 2 : capped[p] ? 1 : 0;
    if (coder.bit(this.pivotCloses[kind]![Math.min(degree[p]!, DEGREES - 1)]!)) {
      this.add(p, q, vertex[R]!, ahead);
      this.close(P, R, Q);
    } else if (S !== R && coder.bit(this.otherCloses[Math.min(degree[q]!, DEGREES - 1)]!)) {
      this.add(p, q, vertex[S]!, ahead);
      this.close(Q, S, P);
    } else if (coder.bit(this.joins)) {
      this.join(P, Q, R, S, ahead);
    } else {
      const mayBeCap = this.hasCaps && !(capped[p] || capped[q] || isCap[p] || isCap[q]);
      const y = this.addVertex(mayBeCap && !!coder.bit(this.caps));
      this.add(p, q, y, ahead);
      const Y = ahead ? this.addNode(y, P, Q) : this.addNode(y, Q, P);
      this.link(P, Q, Y);
      this.link(Q, P, Y);
      this.push(Y);
      this.push(Q);
    }
  }

  /** Drop node N, whose neighbours A and B then meet. */
  private close(N: number, A: number, B: number): void {
    this.dropped[N] = true;
    this.link(A, N, B);
    this.link(B, N, A);
    this.zip(A);
    this.zip(B);
  }

  private join(P: number, Q: number, R: number, S: number, ahead: boolean): void {
    const { coder, vertex } = this;
    let X: number;
    let Y: number;
    if (coder.bit(this.far)) {
      Y = coder.raw(32 - Math.clz32(vertex.length - 1));
      if (Y >= vertex.length || this.dropped[Y]) {
        throw new PayloadError("a join of the control mesh names a node that is not on the border");
      }
      X = ahead ? this.prev[Y]! : this.next[Y]!;
    } else {
      const side = coder.bit(this.side);
      const steps = this.steps.decode(coder);
      if (steps > MAX_STEPS) {
        throw new PayloadError(
          `a join of the control mesh is ${steps} nodes away; at most ${MAX_STEPS} are allowed`,
        );
      }
      let before = side ? P : Q;
      Y = side ? R : S;
      for (let k = 0; k <= steps; k++) [before, Y] = [Y, this.other(Y, before)];
      X = side ? this.other(Y, before) : before;
    }
    const y = vertex[Y]!;
    if (Y === P || Y === Q || Y === R || Y === S || y === vertex[P] || y === vertex[Q]) {
      throw new PayloadError("a join of the control mesh names a node of the gate");
    }
    if (!this.oriented && coder.bit(this.twisted)) X = this.other(Y, X);
    this.add(vertex[P]!, vertex[Q]!, y, ahead);
    const Z = ahead ? this.addNode(y, X, Q) : this.addNode(y, Q, X);
    this.link(X, Y, Z);
    this.link(Y, X, P);
    this.link(P, Q, Y);
    this.link(Q, P, Z);
    for (const N of [Y, Z, P, Q]) this.zip(N);
  }

  /** Where the edges on both sides of a node are one edge, close the gap. */
  private zip(N: number): void {
    if (this.dropped[N]) return;
    const [A, B] = [this.prev[N]!, this.next[N]!];
    if (this.vertex[A] !== this.vertex[B]) {
      this.push(N);
      return;
    }
    this.dropped[N] = this.dropped[B] = true;
    if (A !== B) {
      const C = this.other(B, N);
      this.link(A, N, C);
      this.link(C, B, A);
      this.push(C);
      this.push(A);
    }
  }

  /** The neighbour of N that is not M. */
  private other(N: number, M: number): number {
    return this.next[N] === M ? this.prev[N]! : this.next[N]!;
  }

  /** Put L in the place of N's neighbour M. */
  private link(N: number, M: number, L: number): void {
    if (this.next[N] === M) this.next[N] = L;
    else this.prev[N] = L;
  }

  private addNode(vertex: number, prev: number, next: number): number {
    this.dropped.push(false);
    this.prev.push(prev);
    this.next.push(next);
    return this.vertex.push(vertex) - 1;
  }

  private addVertex(isCap: boolean): number {
    if (this.degree.length === MAX_VERTICES) {
      throw new LimitError(`the control mesh has more than ${MAX_VERTICES} vertices, caps counted`);
    }
    this.isCap.push(isCap);
    this.capped.push(false);
    return this.degree.push(0) - 1;
  }

  private add(p: number, q: number, y: number, ahead: boolean): void {
    if (ahead) this.addFace(p, q, y);
    else this.addFace(q, p, y);
  }

  private addFace(a: number, b: number, c: number): void {
    const { out, degree, isCap, capped } = this;
    if (out.length === 3 * this.maxFaces) {
      throw new LimitError(`the control mesh has more than ${this.maxFaces} faces, those of caps counted`);
    }
    out.push(a, b, c);
    degree[a]!++;
    degree[b]!++;
    degree[c]!++;
    if (isCap[a] || isCap[b] || isCap[c]) capped[a] = capped[b] = capped[c] = true;
  }

  private level(N: number): number {
    return Math.min(this.degree[this.vertex[N]!]!, LEVELS - 1);
  }

  private push(N: number): void {
    this.queues[this.level(N)]!.push(N);
  }

  /** The next pivot, or -1. A node whose vertex has got faces since it was queued goes to a higher queue. */
  private pop(): number {
    do {
      for (let level = LEVELS - 1; level >= 0; level--) {
        const queue = this.queues[level]!;
        for (let N = queue.take(); N !== undefined; N = queue.take()) {
          if (this.dropped[N]) continue;
          if (this.level(N) === level) return N;
          this.push(N);
        }
      }
    } while (this.queues.some((queue) => !queue.isEmpty));
    return -1;
  }
}
