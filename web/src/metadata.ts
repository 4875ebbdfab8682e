/** The sections of metadata: spec/cndhf.md, section 5. */
import { c } from "./constants.js";
import { bfloat16, view } from "./container.js";
import { FieldError } from "./errors.js";

/** What the encoder says of the file. Errors are distances between input and decoded surface, in input units. */
export interface Metadata {
  encoder: string | null;
  source: string | null;
  meanError: number | null;
  p99Error: number | null;
  maxError: number | null;
}

export function readMetadata(bodies: Map<number, Uint8Array>): Metadata {
  const text = (kind: number): string | null => {
    const body = bodies.get(kind);
    if (!body) return null;
    if (body.length > c.MAX_TEXT) throw new FieldError(`metadata: a text has ${body.length} bytes; 255 are allowed`);
    try {
      return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(body);
    } catch {
      throw new FieldError("metadata: a text is not UTF-8");
    }
  };
  const body = bodies.get(c.KIND_ERRORS);
  if (body && body.length !== 6) throw new FieldError(`metadata: the errors have ${body.length} bytes; they have 6`);
  const errors = [0, 2, 4].map((at) => {
    if (!body) return null;
    const error = bfloat16(view(body), at);
    // -0 is refused, too.
    if (!(error < Infinity) || body[at + 1]! > 127) throw new FieldError("metadata: an error is negative or not finite");
    return error;
  });
  const [meanError, p99Error, maxError] = errors as [number, number, number];
  return { encoder: text(c.KIND_ENCODER), source: text(c.KIND_SOURCE), meanError, p99Error, maxError };
}
