/** What models of both representations have in common. */
import type { Header } from "./container.js";
import { OptionError } from "./errors.js";
import type { Metadata } from "./metadata.js";
import type { Mesh } from "./mesh.js";

/** What a file holds, in plain values. */
export interface Info extends Metadata {
  representation: "dhf" | "surface";
  /** Size of the file. */
  bytes: number;
  /** Bytes of each section; "layout" is header, heads of sections and checksum. */
  sections: Record<string, number>;
  centre: [number, number, number];
  scale: number;
}

/** Three coordinates per point. */
export type Points = ArrayLike<number>;

export abstract class Shape {
  abstract readonly representation: "dhf" | "surface";
  /** Input coordinates are centre + scale times normalised ones. */
  declare readonly centre: [number, number, number];
  declare readonly scale: number;

  constructor(
    protected readonly header: Header,
    protected readonly metadata: Metadata,
  ) {
    this.centre = header.centre;
    this.scale = header.scale;
  }

  get info(): Info {
    const { bytes, sizes } = this.header;
    return {
      representation: this.representation,
      bytes,
      sections: sizes,
      centre: this.centre,
      scale: this.scale,
      ...this.metadata,
    };
  }

  /** 1 for each point (input coordinates) inside the solid, 0 for the others. */
  abstract contains(points: Points): Uint8Array;

  abstract toMesh(options?: object): Promise<Mesh>;

  /** Points of input coordinates in the normalised frame. */
  protected normalised(points: Points): Float64Array {
    if (points.length % 3) {
      throw new OptionError(`points has ${points.length} numbers; three per point are needed`);
    }
    return Float64Array.from(points, (x, i) => (x - this.centre[i % 3]!) / this.scale);
  }
}

/** The number that an option says, by default a whole one. Throws OptionError. */
export function option(name: string, value: number, least: number, most: number, isRight = Number.isInteger): number {
  if (!isRight(value) || value < least || value > most) {
    throw new OptionError(`${name} is ${value}; ${least} to ${most} are allowed`);
  }
  return value;
}

export type { Header };
