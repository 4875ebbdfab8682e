/** Loads `.cndhf` files as geometries of three.js; used as DRACOLoader is. */
import { type BufferGeometry, FileLoader, Loader, type LoadingManager } from "three";
import { decode, type DhfMeshOptions, type Mesh, type SurfaceMeshOptions } from "../index.js";
import { MeshWorkers, WorkerError } from "../workers.js";
import { geometryOf } from "./geometry.js";

const WORKERS = 2; // at most, at first

/**
 * ```js
 * const loader = new CNDHFLoader();
 * const geometry = await loader.loadAsync("bracket.cndhf");
 * scene.add(new Mesh(geometry, new MeshStandardMaterial()));
 * ```
 *
 * Positions are those of the mesh that was encoded, less `geometry.userData.origin`: zero, but for shapes far from the
 * origin, which float32 would round.
 */
export class CNDHFLoader extends Loader<BufferGeometry> {
  private options: DhfMeshOptions & SurfaceMeshOptions = {};
  private workers: MeshWorkers | null = null;
  private limit = typeof Worker === "undefined" ? 0 : WORKERS;

  constructor(manager?: LoadingManager) {
    super(manager);
  }

  /** `level` of subdivision or `tolerance` for surfaces, `resolution` of marching cubes for double height fields. */
  setMeshOptions(options: DhfMeshOptions & SurfaceMeshOptions): this {
    this.options = options;
    return this;
  }

  /** How many workers make meshes of double height fields; 0: the page itself does. Surfaces take the page no longer. */
  setWorkerLimit(limit: number): this {
    this.dispose();
    this.limit = limit;
    return this;
  }

  override load(
    url: string,
    onLoad: (geometry: BufferGeometry) => void,
    onProgress?: (event: ProgressEvent) => void,
    onError?: (error: unknown) => void,
  ): void {
    const loader = new FileLoader(this.manager);
    loader.setPath(this.path);
    loader.setResponseType("arraybuffer");
    loader.setRequestHeader(this.requestHeader);
    loader.setWithCredentials(this.withCredentials);
    const fail = (error: unknown): void => {
      if (onError) onError(error);
      else console.error(error);
      this.manager.itemError(url);
    };
    loader.load(url, (data) => this.parse(data as ArrayBuffer, onLoad, fail), onProgress, onError);
  }

  /** A geometry from a file's bytes. */
  parse(
    data: ArrayBuffer | Uint8Array,
    onLoad: (geometry: BufferGeometry) => void,
    onError: (error: unknown) => void = console.error,
  ): void {
    this.parseAsync(data).then(onLoad, onError);
  }

  async parseAsync(data: ArrayBuffer | Uint8Array): Promise<BufferGeometry> {
    return geometryOf(await this.mesh(data instanceof Uint8Array ? data : new Uint8Array(data)));
  }

  /** End the workers. */
  dispose(): this {
    this.workers?.dispose();
    this.workers = null;
    return this;
  }

  private async mesh(bytes: Uint8Array): Promise<Mesh> {
    const model = await decode(bytes);
    if (model.representation === "dhf" && this.limit) {
      this.workers ??= new MeshWorkers(this.limit);
      try {
        return await this.workers.mesh(bytes, this.options);
      } catch (error) {
        if (!(error instanceof WorkerError)) throw error;
        // Some bundlers leave worker.js out, and a page may not start that of another origin.
        console.warn(`cndhf: no worker (${error.message}); the page itself makes the meshes`);
        this.setWorkerLimit(0);
      }
    }
    return model.toMesh(this.options);
  }
}
