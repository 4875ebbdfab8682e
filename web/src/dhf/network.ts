/** Evaluation of one sine network: spec/cndhf.md, section 6.1. */
import type { DhfRecord } from "./records.js";
import { sine } from "./sine.js";

const POINTS = 4; // evaluated at once: each weight is then read once for four products
const ROOTS = [1, 0.8408964152537145, 0.7071067811865476, 0.5946035575013605]; // 2^(-k / 4)

/** The weights of a DHF, rounded to f32, in file order: W0, b0, W1, b1, ... */
export function dequantised(record: DhfRecord, symbols: Int16Array[]): Float32Array[] {
  return symbols.map((tensor, i) => {
    const code = record.steps[i]! & 127;
    const step = ROOTS[code & 3]! * 2 ** -(code >> 2);
    return Float32Array.from(tensor, (s) => s * step);
  });
}

interface Layer {
  inputs: number;
  outputs: number;
  matrix: Float64Array;
  bias: Float64Array;
}

/** A function from points (u, v, u, v, ...) to heights: near, far, near, far, ... */
export function networkOf(tensors: Float32Array[], omegaFirst: number, omegaHidden: number): (uv: Float64Array) => Float64Array {
  const layers: Layer[] = [];
  const last = tensors.length - 2;
  for (let i = 0; i <= last; i += 2) {
    // sin(omega (W x + b)) = sin((omega W) x + omega b)
    const omega = i === last ? 1 : i ? omegaHidden : omegaFirst;
    const [matrix, bias] = [tensors[i]!, tensors[i + 1]!].map((t) => Float64Array.from(t, (w) => w * omega)) as [
      Float64Array, Float64Array,
    ];
    layers.push({ inputs: matrix.length / bias.length, outputs: bias.length, matrix, bias });
  }
  return (uv) => {
    const nPoints = uv.length / 2;
    const out = new Float64Array(uv.length);
    const widest = Math.max(2, layers[0]!.outputs);
    let x = new Float64Array(POINTS * widest);
    let y = new Float64Array(POINTS * widest);
    for (let first = 0; first < nPoints; first += POINTS) {
      const n = Math.min(POINTS, nPoints - first);
      for (let p = 0; p < n; p++) {
        x[p] = uv[2 * (first + p)]!;
        x[POINTS + p] = uv[2 * (first + p) + 1]!;
      }
      for (let k = 0; k < layers.length; k++) {
        apply(layers[k]!, x, y, k < layers.length - 1);
        [x, y] = [y, x];
      }
      for (let p = 0; p < n; p++) {
        out[2 * (first + p)] = x[p]!;
        out[2 * (first + p) + 1] = x[POINTS + p]!;
      }
    }
    return out;
  };
}

/** y = W x + b, or its sine, for four points whose values stand side by side. */
function apply({ inputs, outputs, matrix, bias }: Layer, x: Float64Array, y: Float64Array, sines: boolean): void {
  for (let i = 0, w = 0; i < outputs; i++) {
    let a = bias[i]!;
    let [b, c, d] = [a, a, a];
    for (let j = 0; j < inputs; j++, w++) {
      const weight = matrix[w]!;
      const at = POINTS * j;
      a += weight * x[at]!;
      b += weight * x[at + 1]!;
      c += weight * x[at + 2]!;
      d += weight * x[at + 3]!;
    }
    const at = POINTS * i;
    y[at] = sines ? sine(a) : a;
    y[at + 1] = sines ? sine(b) : b;
    y[at + 2] = sines ? sine(c) : c;
    y[at + 3] = sines ? sine(d) : d;
  }
}
