/** Header, section table and checksum: spec/cndhf.md, section 1. */
import { c } from "./constants.js";
import { crc32 } from "./crc32.js";
import {
  ChecksumError,
  FieldError,
  LimitError,
  SectionError,
  SignatureError,
  TextModeError,
  TrailingDataError,
  TruncatedError,
  VersionError,
} from "./errors.js";

const SIGNATURE = [0x89, 0x44, 0x48, 0x46, 0x0d, 0x0a, 0x1a, 0x0a];

/** One row of the section table, with its bytes in the file. */
export interface Section {
  kind: number;
  codec: number;
  body: Uint8Array;
}

export interface Header {
  version: [number, number];
  nDhfs: number;
  /** Input coordinates of the normalised frame's origin. */
  centre: [number, number, number];
  /** Input units per normalised unit. */
  scale: number;
  /** Of the file. */
  bytes: number;
  sections: Section[];
}

/** The sections that this decoder reads, each with the codec that it must have. */
export interface Contents {
  records?: Section;
  weights?: Section;
  surface?: Section;
  metadata?: Section;
}

export function view(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

/** Read and check what comes before the sections, and the checksum. Throws a FormatError. */
export function readHeader(bytes: Uint8Array): Header {
  checkSignature(bytes);
  const size = bytes.length;
  if (size < c.HEADER_SIZE + c.CRC_SIZE) {
    throw new TruncatedError(`the file ends after ${size} bytes, inside the header`);
  }
  const data = view(bytes);
  const [major, minor, nSections, nDhfs] = bytes.subarray(8) as unknown as [number, number, number, number];
  if (major !== c.MAJOR || (minor !== c.MINOR && minor !== c.MINOR_DHF)) {
    throw new VersionError(
      `the file has format version ${major}.${minor}; this decoder reads 0.1 and 0.2: encode the mesh again`,
    );
  }
  if (size > c.MAX_FILE_SIZE) throw new LimitError(`the file has ${size} bytes; ${c.MAX_FILE_SIZE} are allowed`);
  inRange("field n_sections", nSections, 1, c.MAX_SECTIONS);
  let end = c.HEADER_SIZE + nSections * c.TABLE_ENTRY_SIZE;
  if (size < end + c.CRC_SIZE) throw new TruncatedError(`the file ends after ${size} bytes, inside the section table`);
  const sections: Section[] = [];
  for (let at = c.HEADER_SIZE, i = 0; i < nSections; i++, at += c.TABLE_ENTRY_SIZE) {
    const start = end;
    end += data.getUint32(at + 2, true);
    sections.push({ kind: bytes[at]!, codec: bytes[at + 1]!, body: bytes.subarray(start, end) });
  }
  const announced = `the file has ${size} bytes; its header announces ${end + c.CRC_SIZE}`;
  if (size < end + c.CRC_SIZE) throw new TruncatedError(announced);
  if (size > end + c.CRC_SIZE) throw new TrailingDataError(announced);
  if (crc32(bytes.subarray(0, end)) !== data.getUint32(end, true)) {
    throw new ChecksumError("the checksum does not match: the file is damaged");
  }
  const hasSurface = minor === c.MINOR && sections.some((s) => s.kind === c.KIND_SURFACE);
  inRange("field n_dhfs", nDhfs, hasSurface ? 0 : 1, c.MAX_DHFS);
  const centre = [0, 1, 2].map((k) => data.getFloat64(12 + 8 * k, true)) as Header["centre"];
  if (!centre.every((x) => Math.abs(x) <= c.MAX_CENTRE)) {
    throw new FieldError(`field centre is ${centre}; -2^100 to 2^100 are allowed`);
  }
  const scale = data.getFloat32(36, true);
  if (!(scale >= c.MIN_SCALE && scale <= c.MAX_SCALE)) {
    throw new FieldError(`field scale is ${scale}; 2^-100 to 2^100 are allowed`);
  }
  return { version: [major, minor], nDhfs, centre, scale, bytes: size, sections };
}

/** Find the sections that are known. Throws where one is missing, repeated, or of an unknown kind or codec. */
export function contents(header: Header): Contents {
  const isNew = header.version[1] === c.MINOR;
  const surface = isNew ? sole(header, c.KIND_SURFACE, "surface", [c.CODEC_RANGE]) : undefined;
  for (const { kind } of header.sections) {
    const isDhf = kind === c.KIND_RECORDS || kind === c.KIND_WEIGHTS;
    if (isDhf && surface) {
      throw new SectionError("the file holds a surface and double height fields");
    }
    if (!(isDhf || kind & c.OPTIONAL || (isNew && kind === c.KIND_SURFACE))) {
      throw new SectionError(`section kind ${kind} is unknown`);
    }
  }
  const metadata = sole(header, c.KIND_METADATA, "metadata", [c.CODEC_RAW]);
  if (surface) {
    if (header.nDhfs) throw new FieldError(`field n_dhfs is ${header.nDhfs}; 0 is allowed beside a surface`);
    return { surface, metadata };
  }
  const records = sole(header, c.KIND_RECORDS, "records", [c.CODEC_RAW]);
  const weights = sole(header, c.KIND_WEIGHTS, "weights", [c.CODEC_ZSTD, c.CODEC_RANS]);
  if (!records || !weights) {
    throw new SectionError(`the ${records ? "weights" : "records"} section is missing`);
  }
  return { records, weights, metadata };
}

/** Bytes of each section; "layout" is header, table and checksum, "other" what this decoder skips. */
export function sectionSizes(header: Header): Record<string, number> {
  const names = ["", "records", "weights", "surface"];
  const sizes: Record<string, number> = { layout: c.HEADER_SIZE + c.CRC_SIZE };
  for (const { kind, body } of header.sections) {
    const name = kind === c.KIND_METADATA ? "metadata" : (names[kind] ?? "other");
    sizes[name] = (sizes[name] ?? 0) + body.length;
    sizes["layout"]! += c.TABLE_ENTRY_SIZE;
  }
  return sizes;
}

/** Throw LimitError unless a whole number lies in a range, ends included. */
export function inRange(field: string, value: number, least: number, most: number): void {
  if (value < least || value > most) {
    throw new LimitError(`${field} is ${value}; ${least} to ${most} are allowed`);
  }
}

/** Throw FieldError unless four integers x, y, z, w are near the length that stands for 1. */
export function checkQuaternion(quaternion: number[], name: string): void {
  const squares = quaternion.reduce((sum, x) => sum + x * x, 0);
  if (squares < c.QUATERNION_MIN_NORM ** 2 || squares > c.QUATERNION_MAX_NORM ** 2) {
    throw new FieldError(`${name}: field quaternion has norm ${Math.round(Math.sqrt(squares))}; it must be near 32767`);
  }
}

function checkSignature(bytes: Uint8Array): void {
  const first = SIGNATURE.findIndex((byte, i) => bytes[i] !== byte);
  if (first < 0) return;
  if (first === bytes.length) throw new TruncatedError(`the file ends after ${first} bytes, inside the signature`);
  if (bytes[1] === 0x44 && bytes[2] === 0x48 && bytes[3] === 0x46) {
    throw new TextModeError("the signature is damaged by a text-mode transfer: copy the file as binary");
  }
  throw new SignatureError("this is not a .cndhf file (wrong signature)");
}

function sole(header: Header, kind: number, name: string, codecs: number[]): Section | undefined {
  const found = header.sections.filter((s) => s.kind === kind);
  if (found.length > 1) {
    throw new SectionError(`the ${name} section appears ${found.length} times`);
  }
  const section = found[0];
  if (section && !codecs.includes(section.codec)) {
    throw new SectionError(`the ${name} section has codec ${section.codec}; ${codecs} are allowed`);
  }
  return section;
}
