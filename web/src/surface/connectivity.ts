/** The faces of a control mesh: spec/cndhf.md, section 4.3, whose names these are. */
import { inRange } from "../container.js";
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
  const walked = grown(coder, !oriented, Math.min(MAX_FACES, FREE_FACES + FACES_PER_BYTE * sectionSize));
  const turns = contexts(2);
  let turned = 0;
  const numbers: number[] = []; // of vertices, in order of their first appearance
  let count = 0;
  const faces = new Int32Array(walked.length);
  for (let f = 0; f < faces.length; f += 3) {
    if (!oriented) turned = coder.bit(turns[turned]!);
    let a = (numbers[walked[f]!] ??= count++);
    let b = (numbers[walked[f + 1 + turned]!] ??= count++);
    let c = (numbers[walked[f + 2 - turned]!] ??= count++);
    while (a > b || a > c) [a, b, c] = [b, c, a];
    faces[f] = a;
    faces[f + 1] = b;
    faces[f + 2] = c;
  }
  return faces;
}

/** Grow all components; their faces, without those of caps. */
function grown(coder: RangeDecoder, mayTwist: boolean, maxFaces: number): number[] {
  const out: number[] = [];
  let nFaces = 0; // those of caps included
  // Of nodes.
  const prev: number[] = [];
  const next: number[] = [];
  const vertex: number[] = [];
  const dropped: boolean[] = [];
  // Of vertices.
  const degree: number[] = [];
  const isCap: boolean[] = [];
  const capped: boolean[] = [];

  const queues = Array.from({ length: LEVELS }, () => new Queue());
  const pivotCloses = [0, 1, 2].map(() => PIVOT_CLOSES.map(closing));
  const otherCloses = OTHER_CLOSES.map(closing);
  const joins = closing(2);
  const far = closing(5);
  const [another, caps, sides, twists] = contexts(4) as [Context, Context, Context, Context];
  const stepCounts = new UnsignedModel();

  const hasCaps = coder.bit(new Context());
  while (coder.bit(another)) {
    const a = addVertex();
    const b = addVertex();
    const c = addVertex();
    addFace(a, b, c, true);
    // The border runs the other way round than the face, as the next faces do.
    const n = vertex.length;
    addNode(a, n + 2, n + 1, true);
    addNode(c, n, n + 2, true);
    addNode(b, n + 1, n, true);
    for (let k = 0; k < 3; k++) push(n + k);
    for (let pivot = pop(); pivot >= 0; pivot = pop()) {
      while (!dropped[pivot]) grow(pivot);
    }
  }
  return out;

  function grow(P: number): void {
    const ahead = degree[vertex[next[P]!]!]! >= degree[vertex[prev[P]!]!]!;
    const Q = ahead ? next[P]! : prev[P]!;
    const R = other(P, Q);
    const S = other(Q, P);
    const p = vertex[P]!;
    const q = vertex[Q]!;
    const kind = isCap[p] ? 2 : capped[p] ? 1 : 0;
    if (coder.bit(pivotCloses[kind]![Math.min(degree[p]!, DEGREES - 1)]!)) {
      addFace(p, q, vertex[R]!, ahead);
      close(P, R, Q);
    } else if (S !== R && coder.bit(otherCloses[Math.min(degree[q]!, DEGREES - 1)]!)) {
      addFace(p, q, vertex[S]!, ahead);
      close(Q, S, P);
    } else if (coder.bit(joins)) {
      join(P, Q, R, S, ahead);
    } else {
      const y = addVertex();
      if (hasCaps && !(capped[p] || capped[q] || isCap[p] || isCap[q])) isCap[y] = !!coder.bit(caps);
      addFace(p, q, y, ahead);
      const Y = addNode(y, P, Q, ahead);
      link(P, Q, Y);
      link(Q, P, Y);
      push(Y);
      push(Q);
    }
  }

  /** Drop node N, whose neighbours A and B then meet. */
  function close(N: number, A: number, B: number): void {
    dropped[N] = true;
    link(A, N, B);
    link(B, N, A);
    zip(A);
    zip(B);
  }

  function join(P: number, Q: number, R: number, S: number, ahead: boolean): void {
    let X: number;
    let Y: number;
    if (coder.bit(far)) {
      Y = coder.raw(32 - Math.clz32(vertex.length - 1));
      X = ahead ? prev[Y]! : next[Y]!;
    } else {
      const side = coder.bit(sides);
      const steps = stepCounts.read(coder);
      inRange("the steps of a join of the control mesh", steps, 0, MAX_STEPS, PayloadError);
      let before = side ? P : Q;
      Y = side ? R : S;
      for (let k = 0; k <= steps; k++) [before, Y] = [Y, other(Y, before)];
      X = side ? other(Y, before) : before;
    }
    const y = vertex[Y]!;
    // Of a number that no node has, `dropped` is undefined.
    if (dropped[Y] !== false || [P, Q, R, S].includes(Y) || y === vertex[P] || y === vertex[Q]) {
      throw new PayloadError("a join of the control mesh names a node that it cannot join");
    }
    if (mayTwist && coder.bit(twists)) X = other(Y, X);
    addFace(vertex[P]!, vertex[Q]!, y, ahead);
    const Z = addNode(y, X, Q, ahead);
    link(X, Y, Z);
    link(Y, X, P);
    link(P, Q, Y);
    link(Q, P, Z);
    for (const N of [Y, Z, P, Q]) zip(N);
  }

  /** Where the edges on both sides of a node are one edge, close the gap. */
  function zip(N: number): void {
    if (dropped[N]) return;
    const A = prev[N]!;
    const B = next[N]!;
    if (vertex[A] !== vertex[B]) {
      push(N);
      return;
    }
    dropped[N] = dropped[B] = true;
    if (A !== B) {
      const C = other(B, N);
      link(A, N, C);
      link(C, B, A);
      push(C);
      push(A);
    }
  }

  /** The neighbour of N that is not M. */
  function other(N: number, M: number): number {
    return next[N] === M ? prev[N]! : next[N]!;
  }

  /** Put L in the place of N's neighbour M. */
  function link(N: number, M: number, L: number): void {
    if (next[N] === M) next[N] = L;
    else prev[N] = L;
  }

  /** Add a node of vertex v between two others, which change places unless `ahead`. */
  function addNode(v: number, before: number, after: number, ahead: boolean): number {
    dropped.push(false);
    prev.push(ahead ? before : after);
    next.push(ahead ? after : before);
    return vertex.push(v) - 1;
  }

  function addVertex(): number {
    if (degree.length === MAX_VERTICES) {
      throw new LimitError(`the control mesh has more than ${MAX_VERTICES} vertices`);
    }
    isCap.push(false);
    capped.push(false);
    return degree.push(0) - 1;
  }

  /** Add a face, whose first two vertices change places unless `ahead`. */
  function addFace(a: number, b: number, c: number, ahead: boolean): void {
    if (nFaces++ === maxFaces) throw new LimitError(`the control mesh has more than ${maxFaces} faces`);
    degree[a]!++;
    degree[b]!++;
    degree[c]!++;
    if (isCap[a] || isCap[b] || isCap[c]) capped[a] = capped[b] = capped[c] = true;
    else out.push(ahead ? a : b, ahead ? b : a, c);
  }

  function level(N: number): number {
    return Math.min(degree[vertex[N]!]!, LEVELS - 1);
  }

  function push(N: number): void {
    queues[level(N)]!.push(N);
  }

  /** The next pivot, or -1. A node whose vertex has got faces since it was queued goes to a higher queue. */
  function pop(): number {
    for (let again = true; again; ) {
      again = false;
      for (let k = LEVELS - 1; k >= 0; k--) {
        for (let N; (N = queues[k]!.take()) >= 0; ) {
          if (dropped[N]) continue;
          if (level(N) === k) return N;
          push(N);
          again = true;
        }
      }
    }
    return -1;
  }
}
