/** Meshes that a shape was made from, to compare with. */
import { BufferAttribute, BufferGeometry, Mesh } from "three";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import { PLYLoader } from "three/addons/loaders/PLYLoader.js";
import { STLLoader } from "three/addons/loaders/STLLoader.js";
import type { Object3D } from "three";

/** The triangles of a PLY, OBJ or STL file as one geometry. */
export function readOriginal(name: string, bytes: ArrayBuffer): BufferGeometry {
  const kind = name.toLowerCase().split(".").pop();
  if (kind === "ply") return withIndex(new PLYLoader().parse(bytes));
  if (kind === "stl") return withIndex(new STLLoader().parse(bytes));
  if (kind === "obj") return together(new OBJLoader().parse(new TextDecoder().decode(bytes)));
  throw new Error(`${name}: this page reads .cndhf, and .ply, .obj and .stl to compare with`);
}

function together(root: Object3D): BufferGeometry {
  const points: number[] = [];
  const faces: number[] = [];
  root.updateMatrixWorld(true);
  root.traverse((object) => {
    if (!(object instanceof Mesh)) return;
    const geometry = withIndex((object.geometry as BufferGeometry).clone().applyMatrix4(object.matrixWorld));
    const first = points.length / 3;
    for (const x of geometry.getAttribute("position").array) points.push(x);
    for (const v of geometry.index!.array) faces.push(first + v);
  });
  const out = new BufferGeometry();
  out.setAttribute("position", new BufferAttribute(Float32Array.from(points), 3));
  out.setIndex(faces);
  return withIndex(out);
}

function withIndex(geometry: BufferGeometry): BufferGeometry {
  if (!geometry.index) geometry.setIndex([...Array(geometry.getAttribute("position").count).keys()]);
  if (!geometry.getAttribute("normal")) geometry.computeVertexNormals();
  return geometry;
}
