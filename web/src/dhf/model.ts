/** The representation `dhf`: a solid as the intersection of double height fields. */
import { OptionError, SurfaceError } from "../errors.js";
import { type Mesh, placed } from "../mesh.js";
import type { Metadata } from "../metadata.js";
import { type Header, type Points, Shape, option } from "../model.js";
import type { Field } from "./field.js";

const DEFAULT_RESOLUTION = 128;
const MAX_RESOLUTION = 512;

export interface DhfMeshOptions {
  /** Cells along the longest side of the solid: 8 to 512, 128 by default. */
  resolution?: number;
}

export class DhfModel extends Shape {
  readonly representation = "dhf";

  constructor(
    header: Header,
    metadata: Metadata,
    /** The double height fields, with their weights. */
    readonly fields: Field[],
  ) {
    super(header, metadata);
  }

  /**
   * Near and far heights (near, far, near, far, ...) of field i at points u, v, u, v, ... of its plane: in its own
   * frame, normalised units. Points outside the field's box are clamped to it.
   */
  heights(i: number, uv: ArrayLike<number>): Float64Array {
    const field = this.fields[option("field", i, 0, this.fields.length - 1)]!;
    if (uv.length % 2) throw new OptionError(`uv has ${uv.length} numbers; two per point are needed`);
    return field.heights(uv);
  }

  /** f at points of input coordinates, in input units: positive inside; not a distance. */
  implicit(points: Points): Float64Array {
    const p = this.normalised(points);
    const out = new Float64Array(p.length / 3).fill(Infinity);
    for (const field of this.fields) {
      field.implicit(p).forEach((f, i) => (out[i] = Math.min(out[i]!, f)));
    }
    return out.map((f) => f * this.scale);
  }

  /** The intersection of the first n fields, which holds the whole solid: a file has the one that carves most first. */
  first(n: number): DhfModel {
    return new DhfModel(this.header, this.metadata, this.fields.slice(0, option("fields", n, 1, this.fields.length)));
  }

  contains(points: Points): Uint8Array {
    return Uint8Array.from(this.implicit(points), (f) => (f >= 0 ? 1 : 0));
  }

  /** The surface by marching cubes. Throws OptionError, or SurfaceError where it is empty or too large. */
  async toMesh({ resolution = DEFAULT_RESOLUTION }: DhfMeshOptions = {}): Promise<Mesh> {
    option("resolution", resolution, 8, MAX_RESOLUTION);
    const { isosurface, NoSurfaceError } = await import("./isosurface.js");
    try {
      const { points, normals, index } = isosurface(this.fields, resolution);
      return { ...placed(points, this.centre, this.scale), normals, index };
    } catch (error) {
      throw error instanceof NoSurfaceError ? new SurfaceError(error.message) : error;
    }
  }
}
