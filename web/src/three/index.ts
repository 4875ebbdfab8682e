/** What belongs to three.js: `import { CNDHFLoader } from "cndhf/three"`. */
export { CNDHFLoader } from "./CNDHFLoader.js";
export { geometryOf } from "./geometry.js";
export { CndhfShapePlugin } from "./gltf.js";
export { DhfRayMarch, type RayMarchOptions } from "./rayMarch.js";
