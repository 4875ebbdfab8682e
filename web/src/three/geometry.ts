/** Meshes as geometries of three.js. */
import { BufferAttribute, BufferGeometry } from "three";
import type { Mesh } from "../index.js";

/** With attributes position and normal, an index, and `userData.origin`, which is to be added to positions. */
export function geometryOf({ positions, normals, index, origin }: Mesh): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.userData["origin"] = origin;
  return geometry;
}
