/** The records of double height fields, without their weights: spec/cndhf.md, section 2. */
import { c } from "../constants.js";
import { checkQuaternion, inRange, view } from "../container.js";
import { FieldError, LimitError, TruncatedError } from "../errors.js";

export interface DhfRecord {
  /** Bit 0: heights are mirrored in the middle of the box in u; bit 1: in v. */
  fold: number;
  /** x, y, z, w in units of 1/32767. */
  quaternion: number[];
  /** u min, u max, v min, v max, z min, z max in normalised units. */
  box: number[];
  width: number;
  hiddenLayers: number;
  omegaFirst: number;
  omegaHidden: number;
  /** One byte per tensor: the step code, and bit 7 for symbols of two bytes (codec 1). */
  steps: Uint8Array;
  /** Weights per tensor, in file order: W0, b0, W1, b1, ... */
  sizes: number[];
}

/** Records, and where they end. */
export function readRecords(body: Uint8Array): { records: DhfRecord[]; size: number } {
  const data = view(body);
  const records: DhfRecord[] = [];
  if (!body.length) throw new TruncatedError("the records end before DHF 0");
  const nDhfs = body[0]!;
  inRange("field n_dhfs", nDhfs, 1, c.MAX_DHFS, LimitError);
  let at = 1;
  let parameters = 0;
  for (let i = 0; i < nDhfs; i++) {
    const name = `DHF ${i}`;
    const need = (size: number): void => {
      if (body.length < at + size) throw new TruncatedError(`the records end inside ${name}`);
    };
    need(c.RECORD_HEAD_SIZE);
    const fold = body[at]!;
    const shorts = Array.from({ length: 10 }, (_, k) => data.getInt16(at + 1 + 2 * k, true));
    const [quaternion, box] = [shorts.slice(0, 4), shorts.slice(4)];
    const [width, hiddenLayers, omegaFirst, omegaHidden] = [21, 22, 23, 24].map((k) => body[at + k]!) as [
      number, number, number, number,
    ];
    at += c.RECORD_HEAD_SIZE;
    inRange(`${name}: field width`, width, 1, c.MAX_WIDTH, LimitError);
    inRange(`${name}: field hidden_layers`, hiddenLayers, 1, c.MAX_HIDDEN_LAYERS, LimitError);
    const nTensors = 2 * (hiddenLayers + 2);
    need(nTensors);
    const steps = body.subarray(at, at + nTensors);
    at += nTensors;
    inRange(`${name}: field fold`, fold, 0, 3);
    checkQuaternion(quaternion, name);
    for (let k = 0; k < 6; k += 2) {
      if (box[k]! >= box[k + 1]!) {
        throw new FieldError(`${name}: field box is empty along ${"uvz"[k / 2]} (${box[k]} >= ${box[k + 1]})`);
      }
    }
    if (!omegaFirst || !omegaHidden) throw new FieldError(`${name}: field omega is zero`);
    const sizes = [2 * width, width];
    for (let k = 0; k < hiddenLayers; k++) sizes.push(width * width, width);
    sizes.push(2 * width, 2);
    parameters += sizes.reduce((a, b) => a + b);
    records.push({
      fold, quaternion, box: box.map((x) => x / 2 ** 14), width, hiddenLayers, omegaFirst, omegaHidden, steps, sizes,
    });
  }
  if (parameters > c.MAX_PARAMETERS) {
    throw new LimitError(`the networks have ${parameters} parameters; ${c.MAX_PARAMETERS} are allowed`);
  }
  return { records, size: at };
}
