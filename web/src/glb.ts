/** A mesh as a binary glTF file, with or without the `.cndhf` file that it was made from: see spec/gltf.md. */
import type { Mesh } from "./index.js";

export interface GlbOptions {
  /** The bytes of the `.cndhf` file, to be embedded. */
  embed?: Uint8Array;
  /** With `embed`: whether the mesh is written, too, for readers that do not know the extension. True by default. */
  fallback?: boolean;
}

const FLOAT = 5126;
const UNSIGNED_INT = 5125;

/** The file's bytes. */
export function toGlb({ positions, normals, index, origin }: Mesh, { embed, fallback = true }: GlbOptions = {}): Uint8Array {
  const parts: Uint8Array[] = [];
  const bufferViews: object[] = [];
  let length = 0;
  const add = (part: Uint8Array, target?: number): number => {
    parts.push(part);
    bufferViews.push({ buffer: 0, byteOffset: length, byteLength: part.length, ...(target && { target }) });
    length += part.length + padding(part.length);
    return bufferViews.length - 1;
  };
  const bytes = (a: Float32Array | Uint32Array): Uint8Array => new Uint8Array(a.buffer, a.byteOffset, a.byteLength);
  const withMesh = fallback || !embed;
  const [min, max] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  positions.forEach((x, i) => {
    min[i % 3] = Math.min(min[i % 3]!, x);
    max[i % 3] = Math.max(max[i % 3]!, x);
  });
  const view = (a: Float32Array | Uint32Array, target: number): object =>
    withMesh ? { bufferView: add(bytes(a), target) } : {};
  const count = withMesh ? positions.length / 3 : 3; // as many as a triangle has
  const accessors: object[] = [{ ...view(positions, 34962), componentType: FLOAT, count, type: "VEC3", min, max }];
  const primitive: Record<string, unknown> = { attributes: { POSITION: 0 }, material: 0 };
  if (withMesh) {
    accessors.push({ ...view(normals, 34962), componentType: FLOAT, count, type: "VEC3" });
    accessors.push({ ...view(index, 34963), componentType: UNSIGNED_INT, count: index.length, type: "SCALAR" });
    primitive["attributes"] = { POSITION: 0, NORMAL: 1 };
    primitive["indices"] = 2;
  }
  const isMoved = origin.some((x) => x);
  if (embed) {
    primitive["extensions"] = { CNDHF_shape: { bufferView: add(embed), ...(isMoved && { origin }) } };
  }
  const json = {
    asset: { version: "2.0", generator: "cndhf" },
    ...(embed && { extensionsUsed: ["CNDHF_shape"] }),
    ...(withMesh ? {} : { extensionsRequired: ["CNDHF_shape"] }),
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0, ...(isMoved && { translation: origin }) }],
    meshes: [{ primitives: [primitive] }],
    materials: [{ pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.7 } }],
    accessors,
    bufferViews,
    buffers: [{ byteLength: length }],
  };
  return chunks(new TextEncoder().encode(JSON.stringify(json)), parts, length);
}

const padding = (n: number): number => -n & 3;

function chunks(json: Uint8Array, parts: Uint8Array[], length: number): Uint8Array {
  const jsonLength = json.length + padding(json.length);
  const out = new Uint8Array(12 + 8 + jsonLength + 8 + length);
  const data = new DataView(out.buffer);
  [0x46546c67, 2, out.length, jsonLength, 0x4e4f534a].forEach((x, i) => data.setUint32(4 * i, x, true));
  out.set(json, 20);
  out.fill(0x20, 20 + json.length, 20 + jsonLength);
  let at = 20 + jsonLength;
  data.setUint32(at, length, true);
  data.setUint32(at + 4, 0x004e4942, true);
  at += 8;
  for (const part of parts) {
    out.set(part, at);
    at += part.length + padding(part.length);
  }
  return out;
}
