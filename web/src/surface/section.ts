/** The surface section: bytes to a control mesh. See spec/cndhf.md, section 4. */
import { bfloat16, checkQuaternion, inRange, view } from "../container.js";
import { PayloadError, SectionError } from "../errors.js";
import { decodeConnectivity } from "./connectivity.js";
import { type Edges, edgesOf } from "./manifold.js";
import { decodeMarks } from "./marks.js";
import { decodePositions } from "./positions.js";
import { rangeDecoder } from "./rangeCoder.js";

const HEAD_SIZE = 3;
const ROTATED = 0x10;
const REPEATS = 0x20;
const MAX_EIGHTHS = 8;

/** A control mesh as it is stored. */
export interface ControlMesh {
  /** Takes the normalised frame to that of the grid. */
  quaternion: number[];
  /** Normalised units per grid unit. */
  step: number;
  /** Three integers per vertex. */
  positions: Int32Array;
  /** Three vertices per face. */
  faces: Int32Array;
  edges: Edges;
  /** 1 for each sharp edge, boundary edges included. */
  sharp: Uint8Array;
}

export function decodeSurface(body: Uint8Array): ControlMesh {
  const size = body.length;
  if (size < HEAD_SIZE) throw new SectionError(`the surface section has ${size} bytes; it needs ${HEAD_SIZE}`);
  const data = view(body);
  const flags = body[0]!;
  const eighths = flags & 15;
  const step = bfloat16(data, 1);
  inRange("surface: field flags", flags, 0, 63);
  inRange("surface: field eighths", eighths, 0, MAX_EIGHTHS);
  inRange("surface: field step", step, 2 ** -30, 1);
  let quaternion = [0, 0, 0, 32767];
  let start = HEAD_SIZE;
  if (flags & ROTATED) {
    if (size < start + 8) throw new SectionError("the surface section ends inside its quaternion");
    quaternion = quaternion.map((_, k) => data.getInt16(HEAD_SIZE + 2 * k, true));
    checkQuaternion(quaternion, "surface");
    start += 8;
  }
  const coder = rangeDecoder(body.subarray(start));
  const { faces, nVertices } = decodeConnectivity(coder, size);
  if (!faces.length) throw new PayloadError("the surface section holds no faces");
  const edges = edgesOf(faces, nVertices);
  const sharp = decodeMarks(coder, faces, nVertices, edges);
  const positions = decodePositions(coder, faces, nVertices, edges, eighths, flags & REPEATS);
  coder.finish();
  return { quaternion, step, positions, faces, edges, sharp };
}
