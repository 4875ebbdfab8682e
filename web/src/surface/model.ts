/** The representation `surface`: the limit of a subdivided control mesh. */
import { inRange } from "../container.js";
import { type Header, Shape, type Points, option } from "../model.js";
import { SheetError, SurfaceError } from "../errors.js";
import { type Mesh, placed as toInput } from "../mesh.js";
import type { Metadata } from "../metadata.js";
import { rotationMatrix } from "../rotation.js";
import { type LimitMesh, limitMesh } from "./adaptive.js";
import type { ControlMesh } from "./section.js";
import type { Topology } from "./subdivision.js";
import { windingNumber } from "./winding.js";

const MAX_LEVEL = 6;
const MAX_FACES = 2 ** 23; // of a mesh: half a gigabyte of arrays
const MOST_ADAPTED = 2 ** 19; // faces of the finest level of the mesh by default
const UNKNOWN_ERROR = 2e-4; // of the diagonal: half the mean error where the file says nothing of it
const MOST_TOLERANCE = 0.01; // of the diagonal, whatever the file says

export interface SurfaceMeshOptions {
  /** How often to subdivide, everywhere, in place of a tolerance: 0 to 6. */
  level?: number;
  /**
   * How far triangles may be from the surface, but for a few: 0.01 to 100 times the file's own mean error (0.04 % of the
   * diagonal where it states none), and a hundredth of the diagonal at most. 0.5 by default.
   */
  tolerance?: number;
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
    return edges.opposite.every((o, h) => faces[o] !== faces[h]);
  }

  /**
   * A mesh: by default as fine as the file's error asks for; of a level, its vertices on the limit surface. Throws
   * OptionError or SurfaceError.
   */
  async toMesh({ level, tolerance }: SurfaceMeshOptions = {}): Promise<Mesh> {
    const { points, normals, index, ofSector } = level === undefined ? this.adaptive(tolerance) : this.limit(level);
    return { ...toInput(points, this.centre, this.scale, ofSector), normals, index };
  }

  /** Throws SheetError where there is no inside. Answered from the mesh that `toMesh` makes by default. */
  contains(points: Points): Uint8Array {
    if (!this.closed || !this.oriented) {
      throw new SheetError("the file holds a sheet, which has no inside");
    }
    if (!this.winding) {
      const { points, index, ofSector } = this.adaptive();
      this.winding = windingNumber(points, index.map((sector) => ofSector[sector]!));
    }
    const p = this.normalised(points);
    return new Uint8Array(p.length / 3).map((_, i) =>
      this.winding!(p[3 * i]!, p[3 * i + 1]!, p[3 * i + 2]!) > 0 ? 1 : 0,
    );
  }

  /** The mesh within so many times the file's mean error of the surface, in the normalised frame. */
  private adaptive(times = 0.5): LimitMesh {
    option("tolerance", times, 0.01, 100, Number.isFinite);
    const { meanError, p99Error } = this.metadata;
    const tolerance = (diagonal: number): number =>
      Math.min(times * (meanError && p99Error ? meanError / this.scale : 2 * UNKNOWN_ERROR * diagonal), MOST_TOLERANCE * diagonal);
    const maxLevel = Math.min(MAX_LEVEL, Math.floor(Math.log2(MOST_ADAPTED / (this.control.faces.length / 3)) / 2));
    return limitMesh(this.topology(), this.controlVertices(), maxLevel, this.oriented, tolerance);
  }

  /** The limit surface after `number` steps of subdivision, in the normalised frame. */
  private limit(level: number): LimitMesh {
    option("level", level, 0, MAX_LEVEL);
    const n = (this.control.faces.length / 3) * 4 ** level;
    inRange(`the number of triangles of level ${level}`, n, 1, MAX_FACES, SurfaceError);
    return limitMesh(this.topology(), this.controlVertices(), level, false);
  }

  private topology(): Topology {
    const { faces, edges, sharp } = this.control;
    const { ofHalf, opposite, ends, first } = edges;
    const valences = new Int32Array(first.length);
    const sharpness = new Int32Array(first.length);
    for (let i = 0; i < ends.length; i++) {
      valences[ends[i]!]!++;
      sharpness[ends[i]!]! += sharp[i >> 1]!;
    }
    return { faces, ofHalf, opposite, sharp, valences, sharpness };
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
}
