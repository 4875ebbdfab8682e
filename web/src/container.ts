/** Header, sections and checksum: spec/cndhf.md, section 1. */
import { c } from "./constants.js";
import { crc32 } from "./crc32.js";
import {
  ChecksumError,
  type CndhfError,
  FieldError,
  LimitError,
  SectionError,
  SignatureError,
  TextModeError,
  TruncatedError,
  VersionError,
} from "./errors.js";

const SIGNATURE = "\x89DHF";
const FAR = 2 ** 100; // bounds centre and scale

export interface Header {
  /** Input coordinates of the normalised frame's origin. */
  centre: [number, number, number];
  /** Input units per normalised unit. */
  scale: number;
  /** Of the file. */
  bytes: number;
  /** Bytes of each part; "layout" is what is not the body of a section, "other" what this decoder skips. */
  sizes: Record<string, number>;
  /** Kind of the section that holds the shape. */
  kind: number;
  /** Bodies of the sections that are known, by kind. */
  bodies: Map<number, Uint8Array>;
}

export function view(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** A bfloat16: the upper half of a float32. */
export function bfloat16(data: DataView, at: number): number {
  return new Float32Array(Uint32Array.of(data.getUint16(at, true) << 16).buffer)[0]!;
}

/** Read and check all but what sections hold. Throws a FormatError. */
export function readContainer(bytes: Uint8Array): Header {
  const size = bytes.length;
  const cut = (where: string): TruncatedError => new TruncatedError(`the file ends after ${size} bytes, inside ${where}`);
  // The version comes before all that may differ in another one.
  const start = String.fromCharCode(...bytes.subarray(0, 6));
  if (!start.startsWith(SIGNATURE)) {
    if (SIGNATURE.startsWith(start)) throw cut("the signature");
    if (start.includes("DHF")) throw new TextModeError("the file was damaged by a transfer of text: copy it again, as binary");
    throw new SignatureError("this is not a .cndhf file");
  }
  const version = bytes[4] ?? c.VERSION;
  if (version === c.VERSION_0) throw new VersionError("the file has format 0.x; encode the source mesh again");
  if (version !== c.VERSION) throw new VersionError(`the file has format version ${version}; this decoder reads 1`);
  const end = size - c.CRC_SIZE;
  if (end < c.FRAME_AT) throw cut("its header");
  inRange("the size of the file", size, 0, c.MAX_FILE_SIZE, LimitError);
  const data = view(bytes);
  if (crc32(bytes.subarray(0, end)) !== data.getUint32(end, true)) {
    throw new ChecksumError("the checksum does not match: the file is damaged or incomplete; copy it again");
  }
  const flags = bytes[c.FLAGS_AT]!;
  inRange("field flags", flags, 0, c.FAR_CENTRE);
  let at = flags ? c.SCALE_AT_FAR : c.SCALE_AT;
  if (at + 4 > end) throw cut("its header");
  const centre = [0, 1, 2].map((k) =>
    flags ? data.getFloat64(c.FRAME_AT + 8 * k, true) : data.getFloat32(c.FRAME_AT + 4 * k, true),
  ) as Header["centre"];
  for (const x of centre) inRange("field centre", x, -FAR, FAR);
  const scale = data.getFloat32(at, true);
  inRange("field scale", scale, 1 / FAR, FAR);
  at += 4;
  const sizes: Header["sizes"] = { layout: size };
  const bodies: Header["bodies"] = new Map();
  let shape = 0;
  for (let n = 0; at < end; n++) {
    const kind = bytes[at]!;
    const long = (what: string): SectionError => new SectionError(`the length of a section of kind ${kind} has more ${what}`);
    let length = 0;
    let shift = 0;
    let byte = 128;
    for (; byte > 127 && ++at < end; shift += 7) {
      if (shift === 28) throw long("than 4 bytes");
      byte = bytes[at]!;
      length |= (byte & 127) << shift;
    }
    if (!byte && shift > 7) throw long("bytes than it needs");
    const start = ++at;
    at += length;
    if (at > end) throw new TruncatedError("the last section goes on beyond the end of the file");
    if (n === c.MAX_SECTIONS) throw new LimitError(`the file has more than ${n} sections`);
    const isShape = kind && kind <= c.KIND_SURFACE;
    const isKnown = isShape || (kind > c.OPTIONAL && kind <= c.KIND_SOURCE);
    if (!isKnown && kind < c.OPTIONAL) throw new SectionError(`a section has kind ${kind}, which this decoder does not know`);
    if (bodies.has(kind)) throw new SectionError(`there are 2 sections of kind ${kind}`);
    if (isShape && shape) throw new SectionError("the file holds two shapes");
    if (isShape) shape = kind;
    if (isKnown) bodies.set(kind, bytes.subarray(start, at));
    const name = isShape ? "surface" : isKnown ? "metadata" : "other";
    sizes[name] = (sizes[name] ?? 0) + length;
    sizes["layout"]! -= length;
  }
  if (!shape) throw new SectionError("the file holds no shape");
  return { centre, scale, bytes: size, sizes, kind: shape, bodies };
}

/** Throw an error of this kind unless a number lies in a range, ends included. */
export function inRange(
  field: string,
  value: number,
  least: number,
  most: number,
  Kind: new (message: string) => CndhfError = FieldError,
): void {
  if (!(value >= least && value <= most)) throw new Kind(`${field} is ${value}; ${least} to ${most} are allowed`);
}

/** Throw FieldError unless four integers x, y, z, w are near the length that stands for 1. */
export function checkQuaternion(quaternion: number[], name: string): void {
  const squares = quaternion.reduce((sum, x) => sum + x * x, 0);
  if (squares < c.QUATERNION_MIN_NORM ** 2 || squares > c.QUATERNION_MAX_NORM ** 2) {
    throw new FieldError(`${name}: field quaternion has norm ${Math.round(Math.sqrt(squares))}; it must be near 32767`);
  }
}
