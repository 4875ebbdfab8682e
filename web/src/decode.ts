/** Bytes to a model. */
import { c } from "./constants.js";
import { readContainer } from "./container.js";
import { Field } from "./dhf/field.js";
import { DhfModel } from "./dhf/model.js";
import { dequantised } from "./dhf/network.js";
import { decodeRans } from "./dhf/rans.js";
import { readRecords } from "./dhf/records.js";
import { FieldError, OptionError, PayloadError } from "./errors.js";
import { readMetadata } from "./metadata.js";
import { SurfaceModel } from "./surface/model.js";
import { decodeSurface } from "./surface/section.js";

export type Model = DhfModel | SurfaceModel;

/**
 * Read and check a whole `.cndhf` file.
 *
 * Files of preset `paper` need zstd, which is loaded on the first of them; hence the promise. It is rejected with a
 * FormatError that says what is wrong with the bytes.
 */
export async function decode(data: Uint8Array | ArrayBuffer): Promise<Model> {
  const bytes = data instanceof ArrayBuffer ? new Uint8Array(data) : data;
  if (!(bytes instanceof Uint8Array)) throw new OptionError("data is no Uint8Array or ArrayBuffer");
  const header = readContainer(bytes);
  const about = readMetadata(header.bodies);
  const body = header.bodies.get(header.kind)!;
  if (header.kind === c.KIND_SURFACE) return new SurfaceModel(header, about, decodeSurface(body));
  const { records, size } = readRecords(body);
  const weights = body.subarray(size);
  const { surface, ...others } = header.sizes;
  header.sizes = { ...others, records: size, weights: surface! - size };
  const sizes = records.flatMap((d) => d.sizes);
  const wide = records.flatMap((d) => [...d.steps].map((step) => step > 127));
  let symbols: Int16Array[];
  if (header.kind === c.KIND_RANS) {
    if (wide.includes(true)) {
      throw new FieldError("a step byte has bit 7 set, with codec 2");
    }
    symbols = decodeRans(weights, sizes);
  } else {
    const { decodeZstd, ZstdError } = await import("./zstd/weights.js");
    try {
      symbols = decodeZstd(weights, sizes, wide);
    } catch (error) {
      if (error instanceof ZstdError) throw new PayloadError(error.message);
      throw error instanceof RangeError ? new FieldError(error.message) : error;
    }
  }
  let at = 0;
  const fields = records.map((record) => {
    const n = record.sizes.length;
    return new Field(record, dequantised(record, symbols.slice(at, (at += n))));
  });
  return new DhfModel(header, about, fields);
}
