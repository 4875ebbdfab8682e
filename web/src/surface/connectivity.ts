/** The faces of a control mesh: spec/cndhf.md, section 4.3, whose names these are. */
import { inRange } from "../container.js";
import { LimitError, PayloadError } from "../errors.js";
import { unsignedModel } from "./models.js";
import { Queue } from "./queue.js";
import { type Context, type RangeDecoder, closing, context, contexts } from "./rangeCoder.js";

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
export function decodeConnectivity(coder: RangeDecoder, sectionSize: number): { faces: Int32Array; nVertices: number } {
  const oriented = coder.bit(context());
  const walked = grown(coder, !oriented, Math.min(MAX_FACES, FREE_FACES + FACES_PER_BYTE * sectionSize));
  const turns = contexts(2);
  let turned = 0;
  const numbers: number[] = []; // of vertices, in order of their first appearance, from 1
  let nVertices = 0;
  const numberOf = (v: number): number => (numbers[v] ||= ++nVertices) - 1;
  const faces = new Int32Array(walked.length);
  for (let f = 0; f < faces.length; f += 3) {
    if (!oriented) turned = coder.bit(turns[turned]!);
    const a = numberOf(walked[f]!);
    const b = numberOf(walked[f + 1 + turned]!);
    const c = numberOf(walked[f + 2 - turned]!);
    const k = a < b && a < c ? 0 : b < c ? 2 : 1; // the least comes first
    faces[f + k] = a;
    faces[f + ((k + 1) % 3)] = b;
    faces[f + ((k + 2) % 3)] = c;
  }
  return { faces, nVertices };
}

/** Grow all components; their faces, without those of caps. */
function grown(coder: RangeDecoder, mayTwist: boolean, maxFaces: number): number[] {
  const out: number[] = [];
  let nFaces = 0; // those of caps included
  // Of nodes.
  const prev: number[] = [];
  const next: number[] = [];
  const vertex: number[] = [];
  const alive: boolean[] = [];
  // Of vertices.
  const degree: number[] = [];
  const caps: number[] = []; // 1 in a face of a cap, 2 the middle of a cap

  const queues = Array.from({ length: LEVELS }, () => new Queue());
  const pivotCloses = [0, 1, 2].map(() => PIVOT_CLOSES.map(closing));
  const otherCloses = OTHER_CLOSES.map(closing);
  const joins = closing(2);
  const far = closing(5);
  const [another, covers, sides, twists] = contexts(4) as [Context, Context, Context, Context];
  const stepCount = unsignedModel(coder);

  const { bit } = coder;
  const hasCaps = bit(context());
  while (bit(another)) {
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
      while (alive[pivot]) grow(pivot);
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
    if (bit(pivotCloses[caps[p]!]![Math.min(degree[p]!, DEGREES - 1)]!)) {
      addFace(p, q, vertex[R]!, ahead);
      close(P, R, Q);
    } else if (S !== R && bit(otherCloses[Math.min(degree[q]!, DEGREES - 1)]!)) {
      addFace(p, q, vertex[S]!, ahead);
      close(Q, S, P);
    } else if (bit(joins)) {
      join(P, Q, R, S, ahead);
    } else {
      const y = addVertex();
      if (hasCaps && !caps[p] && !caps[q]) caps[y] = 2 * bit(covers);
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
    alive[N] = false;
    link(A, N, B);
    link(B, N, A);
    zip(A);
    zip(B);
  }

  function join(P: number, Q: number, R: number, S: number, ahead: boolean): void {
    let X: number;
    let Y: number;
    if (bit(far)) {
      Y = coder.raw(32 - Math.clz32(vertex.length - 1));
      X = ahead ? prev[Y]! : next[Y]!;
    } else {
      const side = bit(sides);
      const steps = stepCount();
      inRange("the steps of a join of the control mesh", steps, 0, MAX_STEPS, PayloadError);
      let before = side ? P : Q;
      Y = side ? R : S;
      for (let k = 0; k <= steps; k++) [before, Y] = [Y, other(Y, before)];
      X = side ? other(Y, before) : before;
    }
    const y = vertex[Y]!;
    if (!alive[Y] || [P, Q, R, S].includes(Y) || y === vertex[P] || y === vertex[Q]) {
      throw new PayloadError("a join of the control mesh names a node that it cannot join");
    }
    if (mayTwist && bit(twists)) X = other(Y, X);
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
    if (!alive[N]) return;
    const A = prev[N]!;
    const B = next[N]!;
    if (vertex[A] !== vertex[B]) {
      push(N);
      return;
    }
    alive[N] = alive[B] = false;
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
    prev.push(ahead ? before : after);
    next.push(ahead ? after : before);
    alive.push(true);
    return vertex.push(v) - 1;
  }

  function addVertex(): number {
    if (degree.length === MAX_VERTICES) {
      throw new LimitError(`the control mesh has more than ${MAX_VERTICES} vertices`);
    }
    caps.push(0);
    return degree.push(0) - 1;
  }

  /** Add a face, whose first two vertices change places unless `ahead`. */
  function addFace(a: number, b: number, c: number, ahead: boolean): void {
    if (nFaces++ === maxFaces) throw new LimitError(`the control mesh has more than ${maxFaces} faces`);
    degree[a]!++;
    degree[b]!++;
    degree[c]!++;
    if (caps[a]! > 1 || caps[b]! > 1 || caps[c]! > 1) for (const v of [a, b, c]) caps[v] ||= 1;
    else out.push(ahead ? a : b, ahead ? b : a, c);
  }

  function push(N: number): void {
    queues[Math.min(degree[vertex[N]!]!, LEVELS - 1)]!.push(N);
  }

  /** The next pivot, or -1. A node whose vertex has got faces since it was queued goes to a higher queue. */
  function pop(): number {
    for (let again = true; again; ) {
      again = false;
      for (let k = LEVELS - 1; k >= 0; k--) {
        for (let N; (N = queues[k]!.take()) >= 0; ) {
          if (!alive[N]) continue;
          if (k === LEVELS - 1 || degree[vertex[N]!] === k) return N;
          push(N);
          again = true;
        }
      }
    }
    return -1;
  }
}
