/** Decoder of `.cndhf` files: 3D shapes in 1 to 20 kB. */
export { decode, type Model } from "./decode.js";
export { DhfModel, type DhfMeshOptions } from "./dhf/model.js";
export type { Field } from "./dhf/field.js";
export * from "./errors.js";
export type { Mesh } from "./mesh.js";
export type { Metadata } from "./metadata.js";
export type { Info } from "./model.js";
export { SurfaceModel, type SurfaceMeshOptions } from "./surface/model.js";
export type { ControlMesh } from "./surface/section.js";
