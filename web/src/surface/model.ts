/** The representation `surface`: the limit of a subdivided control mesh. */
import { type Header, Shape, type Points, whole } from "../model.js";
import { SheetError, SurfaceError } from "../errors.js";
import { type Mesh, placed } from "../mesh.js";
import type { Metadata } from "../metadata.js";
import { rotationMatrix } from "../rotation.js";
import { type LimitMesh, limitMesh } from "./limit.js";
import type { ControlMesh } from "./section.js";
import { divide, nextVertices, type Topology } from "./subdivision.js";
import { windingNumber } from "./winding.js";

const MAX_LEVEL = 6;
const MAX_FACES = 2 ** 23; // of a mesh: half a gigabyte of arrays
// The level that is taken by default is the finest one with at most so many triangles, but LEVELS_ENOUGH at most.
const FACES_ENOUGH = 2 ** 15;
const LEVELS_ENOUGH = 4;

export interface SurfaceMeshOptions {
  /** How often to subdivide: 0 to 6. By default as often as leaves at most 32,768 triangles, but 4 times at most. */
  level?: number;
}

export class SurfaceModel extends Shape {
  readonly representation = "surface";
  private winding: ReturnType<typeof windingNumber> | undefined;

  constructor(
    header: Header,
    metadata: Metadata,
    /** What the file stores. */
    readonly control: ControlMesh,
  ) {
    super(header, metadata);
  }

  /** Whether every edge has two faces; if not, it is a sheet, which has no inside. */
  get closed(): boolean {
    return !this.control.edges.opposite.includes(-1);
  }

  /** Whether neighbouring faces agree in orientation. */
  get oriented(): boolean {
    const { faces, edges } = this.control;
    return edges.opposite.every((o, h) => o < 0 || faces[o] !== faces[h]);
  }

  /** The mesh of a level of subdivision, its vertices on the limit surface. Throws OptionError or SurfaceError. */
  async toMesh({ level = this.defaultLevel() }: SurfaceMeshOptions = {}): Promise<Mesh> {
    const { points, normals, index } = this.limit(level);
    return { ...placed(points, this.centre, this.scale), normals, index };
  }

  /** Throws SheetError where there is no inside. Answered from the mesh that `toMesh` makes by default. */
  contains(points: Points): Uint8Array {
    if (!this.closed || !this.oriented) {
      throw new SheetError("the file holds a sheet, which has no inside");
    }
    if (!this.winding) {
      const { points, index, further } = this.limit(this.defaultLevel());
      const n = points.length / 3 - further.length;
      this.winding = windingNumber(points, index.map((sector) => further[sector - n] ?? sector));
    }
    const p = this.normalised(points);
    return new Uint8Array(p.length / 3).map((_, i) =>
      this.winding!(p[3 * i]!, p[3 * i + 1]!, p[3 * i + 2]!) > 0 ? 1 : 0,
    );
  }

  /** The limit surface after `number` steps of subdivision, in the normalised frame. */
  private limit(number: number): LimitMesh {
    whole("level", number, 0, MAX_LEVEL);
    const { faces, edges, sharp } = this.control;
    const nFaces = (faces.length / 3) * 4 ** number;
    if (nFaces > MAX_FACES) {
      throw new SurfaceError(`level ${number} has ${nFaces} triangles; ${MAX_FACES} are allowed`);
    }
    const { ofHalf, opposite, ends, first } = edges;
    let mesh: Topology = {
      faces, ofHalf, opposite, sharp,
      valences: new Int32Array(first.length),
      sharpness: new Int32Array(first.length),
    };
    for (let i = 0; i < ends.length; i++) {
      mesh.valences[ends[i]!]!++;
      mesh.sharpness[ends[i]!]! += sharp[i >> 1]!;
    }
    let vertices = this.controlVertices();
    for (let k = 0; k < number; k++) {
      if (k) mesh = divide(mesh);
      vertices = nextVertices(mesh, vertices);
    }
    return limitMesh(mesh, vertices, number > 0);
  }

  /** Control vertices in the normalised frame, three coordinates each. */
  controlVertices(): Float64Array {
    const { positions, step, quaternion } = this.control;
    const r = rotationMatrix(quaternion);
    const out = new Float64Array(positions.length);
    for (let i = 0; i < out.length; i += 3) {
      const x = step * positions[i]!;
      const y = step * positions[i + 1]!;
      const z = step * positions[i + 2]!;
      for (let k = 0; k < 3; k++) out[i + k] = r[k]! * x + r[3 + k]! * y + r[6 + k]! * z;
    }
    return out;
  }

  private defaultLevel(): number {
    const times = Math.floor(Math.log2((3 * FACES_ENOUGH) / this.control.faces.length) / 2);
    return Math.min(Math.max(times, 0), LEVELS_ENOUGH);
  }
}
