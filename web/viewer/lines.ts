/** Lines that explain a surface: its control mesh and its creases. */
import { BufferAttribute, BufferGeometry } from "three";
import type { Mesh, SurfaceModel } from "../src/index.js";

function lines(points: Float32Array, pairs: number[]): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setIndex(pairs);
  return geometry;
}

/** The edges of the control mesh, in input coordinates less `origin`. */
export function controlLines(model: SurfaceModel, origin: number[]): BufferGeometry {
  const points = model.controlVertices().map((x, i) => x * model.scale + model.centre[i % 3]! - origin[i % 3]!);
  return lines(Float32Array.from(points), [...model.control.edges.ends]);
}

/** The edges of a mesh where vertices are doubled for the sake of their normals, and the boundary. */
export function creaseLines({ positions, index }: Mesh): BufferGeometry {
  const n = positions.length / 3;
  const edges = new Set<number>();
  const next = (h: number): number => (h % 3 === 2 ? h - 2 : h + 1);
  index.forEach((v, h) => edges.add(v * n + index[next(h)]!));
  const pairs: number[] = [];
  index.forEach((v, h) => {
    const w = index[next(h)]!;
    if (!edges.has(w * n + v)) pairs.push(v, w);
  });
  return lines(positions, pairs);
}
