/** The metadata section: spec/cndhf.md, section 5. */
import { view } from "./container.js";
import { FieldError, SectionError } from "./errors.js";

/** What the encoder says of the file. Errors are distances between input and decoded surface, in input units. */
export interface Metadata {
  encoder: string | null;
  source: string | null;
  meanError: number | null;
  p99Error: number | null;
  maxError: number | null;
}

export function readMetadata(body: Uint8Array = new Uint8Array()): Metadata {
  const values = new Map<number, Uint8Array>();
  for (let at = 0; at < body.length; ) {
    const end = at + 2 + body[at + 1]!;
    if (!(end <= body.length)) throw new SectionError("the metadata section ends inside an entry");
    const tag = body[at]!;
    if (values.has(tag)) throw new SectionError(`the metadata section has tag ${tag} twice`);
    values.set(tag, body.subarray(at + 2, end));
    at = end;
  }
  const text = (tag: number): string | null => {
    const value = values.get(tag);
    if (!value) return null;
    try {
      return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(value);
    } catch {
      throw new FieldError("metadata: a text is not UTF-8");
    }
  };
  const value = values.get(2);
  if (value && value.length !== 12) throw new FieldError("metadata: the error entry does not have 12 bytes");
  const errors = [0, 4, 8].map((at) => (value ? view(value).getFloat32(at, true) : null));
  if (!errors.every((e) => e === null || (e >= 0 && e < Infinity))) {
    throw new FieldError("metadata: an error is negative or not finite");
  }
  const [meanError, p99Error, maxError] = errors as [number, number, number];
  return { encoder: text(1), source: text(3), meanError, p99Error, maxError };
}
