/**
 * The cases of marching cubes (Lorensen and Cline, 1987), made by a rule: on each face of a cell, every run of outside
 * corners is cut off. Both cells of a face cut it in the same way, so the surface is closed.
 *
 * Corner c of a cell is at x = c >> 2, y = c >> 1 & 1, z = c & 1. Edge 3 c + axis goes from corner c along that axis,
 * 0 for x. A case is the sum of 2^c over inside corners.
 */
let made: number[][] | undefined;

/** Per case, three edges per triangle, anticlockwise seen from outside. */
export function cases(): number[][] {
  return (made ??= Array.from({ length: 256 }, (_, inside) => triangles(inside)));
}

const bit = (axis: number): number => 4 >> axis;

/** The corners of each face, anticlockwise seen from outside the cell. */
const FACES = [0, 1, 2].flatMap((axis) => {
  const [a, b] = [bit((axis + 1) % 3), bit((axis + 2) % 3)];
  const low = [0, b, a + b, a];
  return [low, low.map((c) => c + bit(axis)).reverse()];
});

function edgeBetween(a: number, b: number): number {
  return 3 * Math.min(a, b) + [4, 2, 1].indexOf(a ^ b);
}

function triangles(inside: number): number[] {
  const isInside = (c: number): boolean => ((inside >> c) & 1) === 1;
  const next = new Map<number, number>(); // the pieces of the surface's border with the faces of the cell
  for (const face of FACES) {
    for (let i = 0; i < 4; i++) {
      const [corner, before] = [face[i]!, face[(i + 3) % 4]!];
      if (isInside(corner) || !isInside(before)) continue;
      let j = i;
      while (!isInside(face[(j + 1) % 4]!)) j++;
      next.set(edgeBetween(face[j % 4]!, face[(j + 1) % 4]!), edgeBetween(before, corner));
    }
  }
  const out: number[] = [];
  while (next.size) {
    const loop: number[] = [];
    for (let edge = next.keys().next().value; edge !== undefined && next.has(edge); ) {
      loop.push(edge);
      const following: number = next.get(edge)!;
      next.delete(edge);
      edge = following;
    }
    out.push(...triangulated(loop)!);
  }
  return out;
}

/** A polygon of edges as triangles, none with a side across a face of the cell; null if there is no such way. */
function triangulated(loop: number[]): number[] | null {
  const last = loop.length - 1;
  if (last < 2) return [];
  for (let k = 1; k < last; k++) {
    if (k > 1 && shareFace(loop[0]!, loop[k]!)) continue;
    if (k < last - 1 && shareFace(loop[k]!, loop[last]!)) continue;
    const [a, b] = [triangulated(loop.slice(0, k + 1)), triangulated(loop.slice(k))];
    if (a && b) return [loop[0]!, loop[k]!, loop[last]!, ...a, ...b];
  }
  return null;
}

function shareFace(a: number, b: number): boolean {
  const corners = [a, b].flatMap((edge) => {
    const c = Math.floor(edge / 3);
    return [c, c + bit(edge % 3)];
  });
  return FACES.some((face) => corners.every((c) => face.includes(c)));
}
