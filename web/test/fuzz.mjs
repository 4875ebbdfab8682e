// Damaged files: none may hang, or throw anything but a CndhfError. node test/fuzz.mjs [FILES] [SEED]
//
// Blind damage hardly ever gets past the checksum. So a file's sections are taken apart, some bytes of some are changed,
// and lengths and checksum are made to fit again, most of the time. What decodes is asked for a point and a mesh.
import { pathToFileURL } from "node:url";
import { CndhfError, decode } from "../dist/index.js";
import { bytesOf, expected, rowsOf, vector } from "./files.mjs";

const SLOW = 10_000; // milliseconds: a file that takes longer counts as a hang
const BYTES = [0, 1, 2, 3, 7, 8, 16, 30, 59, 60, 63, 64, 127, 128, 129, 254, 255];

/** Mulberry32: numbers from 0 to 1 that a seed fixes. */
function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

const TABLE = Array.from({ length: 256 }, (_, i) => {
  for (let k = 0; k < 8; k++) i = i & 1 ? (i >>> 1) ^ 0xedb88320 : i >>> 1;
  return i;
});

export function crc32(bytes) {
  let crc = -1;
  for (const byte of bytes) crc = (crc >>> 8) ^ TABLE[(crc ^ byte) & 255];
  return ~crc >>> 0;
}

function partsOf(bytes) {
  const head = bytes[5] ? 34 : 22;
  const sections = [];
  for (let at = head; at < bytes.length - 4; ) {
    const kind = bytes[at];
    let [size, shift] = [0, 0];
    do {
      size += (bytes[++at] & 127) << shift;
      shift += 7;
    } while (bytes[at] > 127);
    sections.push({ kind, body: [...bytes.subarray(++at, (at += size))] });
  }
  return { head: [...bytes.subarray(0, head)], sections };
}

function joined({ head, sections }, chance) {
  const out = [...head];
  for (const { kind, body } of sections) {
    let size = chance() < 0.99 ? body.length : Math.max(0, body.length + Math.floor(chance() * 5) - 2);
    out.push(kind);
    for (; size > 127; size >>= 7) out.push((size & 127) | 128);
    if (chance() < 0.99) out.push(size);
    else out.push(size | 128, 0); // a byte more than it needs
    for (const byte of body) out.push(byte);
  }
  const crc = chance() < 0.98 ? crc32(out) : 0;
  out.push(crc & 255, (crc >>> 8) & 255, (crc >>> 16) & 255, crc >>> 24);
  return Uint8Array.from(out);
}

/** Change one place of a list of bytes. */
function damage(bytes, chance) {
  const at = Math.floor(chance() * (bytes.length + 1));
  const byte = chance() < 0.5 ? BYTES[Math.floor(chance() * BYTES.length)] : Math.floor(chance() * 256);
  const size = chance() < 0.8 ? 1 : Math.floor(chance() * 20);
  const kind = chance();
  if (kind < 0.35) bytes[Math.min(at, bytes.length - 1)] = byte;
  else if (kind < 0.65) bytes[Math.min(at, bytes.length - 1)] ^= 1 << Math.floor(chance() * 8);
  else if (kind < 0.75) bytes.splice(at, size);
  else if (kind < 0.85) bytes.splice(at, 0, ...Array(size).fill(byte));
  else if (kind < 0.92) bytes.splice(at, 0, ...bytes.slice(at, at + size));
  else if (kind < 0.95) bytes.length = at;
  else for (let k = at; k < Math.min(at + size, bytes.length); k++) bytes[k] = Math.floor(chance() * 256);
}

function damaged(seeds, chance) {
  const pick = () => partsOf(seeds[Math.floor(chance() * seeds.length)]);
  const parts = pick();
  for (let n = 1 + Math.floor(chance() ** 3 * 8); n > 0; n--) {
    const what = chance();
    const section = parts.sections[Math.floor(chance() * parts.sections.length)];
    if (what < 0.85 && section) damage(section.body, chance);
    else if (what < 0.92) {
      const at = 4 + Math.floor(chance() * (parts.head.length - 4));
      parts.head[at] = BYTES[Math.floor(chance() * BYTES.length)];
    } else if (what < 0.97 && section) section.kind = [1, 2, 3, 0x81, 0x82, 0x83, 0x90, 4][Math.floor(chance() * 8)];
    else if (what < 0.985) parts.sections.push(...pick().sections.slice(0, 1));
    else parts.sections.splice(Math.floor(chance() * parts.sections.length), 1);
  }
  return joined(parts, chance);
}

async function use(bytes, chance) {
  const model = await decode(bytes);
  void model.info;
  const { centre, scale } = model;
  if (model.representation === "dhf") {
    model.heights(0, [0.1, -0.2]);
    if (chance() < 0.1) await model.toMesh({ resolution: 8 });
  } else {
    const level = Math.floor(chance() * 2);
    if (model.control.faces.length < 3000) await model.toMesh({ level });
    else return;
  }
  model.contains([0, 1, 2].map((k) => centre[k] + 0.1 * scale));
}

/** Decode so many damaged files; how many were refused, by the name of the error, and the slowest. */
export async function fuzz(nFiles, seed) {
  const seeds = [
    ...Object.keys(expected).map(vector),
    ...rowsOf("spec/vectors/accepted").map(([name]) => `spec/vectors/accepted/${name}`),
  ].map(bytesOf);
  const results = {};
  let slowest = 0;
  for (let n = 0; n < nFiles; n++) {
    const chance = random(seed * 1_000_003 + n);
    const bytes = damaged(seeds, chance);
    const start = performance.now();
    let result = "decoded";
    try {
      await use(bytes, chance);
    } catch (error) {
      if (!(error instanceof CndhfError)) {
        throw new Error(`file ${n} of seed ${seed}: ${error?.stack}\n${Buffer.from(bytes).toString("base64")}`);
      }
      result = error.name;
    }
    const time = performance.now() - start;
    slowest = Math.max(slowest, time);
    if (time > SLOW) throw new Error(`file ${n} of seed ${seed} takes ${time} ms`);
    results[result] = (results[result] ?? 0) + 1;
  }
  return { results, slowest };
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) {
  const [nFiles = "20000", seed = "0"] = process.argv.slice(2);
  const { results, slowest } = await fuzz(Number(nFiles), Number(seed));
  console.log(`${nFiles} files of seed ${seed}: slowest ${slowest.toFixed(0)} ms`, results);
}
