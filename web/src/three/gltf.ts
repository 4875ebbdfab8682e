/** A plugin for three.js' GLTFLoader that reads the glTF extension `CNDHF_shape`: see spec/gltf.md. */
import { type BufferGeometry, Mesh, type Object3D } from "three";
import type { CNDHFLoader } from "./CNDHFLoader.js";

const NAME = "CNDHF_shape";

/** The extension of a primitive. */
interface Shape {
  bufferView: number;
  origin?: [number, number, number];
}

/** What the plugin uses of GLTFLoader's parser. */
export interface GltfParser {
  json: { meshes?: { primitives: { extensions?: Record<string, Shape | undefined> }[] }[] };
  associations: Map<unknown, { meshes?: number; primitives?: number } | undefined>;
  getDependency(type: string, index: number): Promise<unknown>;
}

/**
 * ```js
 * const loader = new GLTFLoader().register((parser) => new CndhfShapePlugin(parser, new CNDHFLoader()));
 * ```
 *
 * Each primitive that carries a `.cndhf` file gets its geometry from there; a fallback is put aside.
 */
export class CndhfShapePlugin {
  readonly name = NAME;

  constructor(
    private readonly parser: GltfParser,
    private readonly loader: CNDHFLoader,
  ) {}

  async afterRoot({ scenes }: { scenes: Object3D[] }): Promise<void> {
    const { parser } = this;
    const made = new Map<Shape, Promise<BufferGeometry>>();
    const work: Promise<void>[] = [];
    for (const scene of scenes) {
      scene.traverse((object) => {
        if (!(object instanceof Mesh)) return;
        const { meshes, primitives = 0 } = parser.associations.get(object) ?? {};
        const shape = parser.json.meshes?.[meshes ?? -1]?.primitives[primitives]?.extensions?.[NAME];
        if (!shape) return;
        if (!made.has(shape)) made.set(shape, this.geometry(shape));
        work.push(made.get(shape)!.then((geometry) => {
          object.geometry.dispose();
          object.geometry = geometry;
        }));
      });
    }
    await Promise.all(work);
  }

  private async geometry({ bufferView, origin = [0, 0, 0] }: Shape): Promise<BufferGeometry> {
    const bytes = (await this.parser.getDependency("bufferView", bufferView)) as ArrayBuffer;
    const geometry = await this.loader.parseAsync(bytes);
    const from = geometry.userData["origin"] as [number, number, number];
    const [x, y, z] = from.map((c, k) => c - origin[k]!) as [number, number, number];
    if (x || y || z) geometry.translate(x, y, z);
    geometry.userData["origin"] = origin;
    return geometry;
  }
}
