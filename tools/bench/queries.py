"""Queries of triangle meshes, as ratios measured in one run: times of a shared machine mean little by themselves.

    python tools/bench/queries.py a.ply b.ply [--faces 50000] [--points 1000000]

Meshes are brought to the normalised frame and simplified. `contains`, its cells yet to be made, stands beside trimesh's
with embreex; `nearest` and `distance` beside libigl's distances; rays beside embreex. Points are drawn uniformly from
the mesh's box, and from the surface, moved by a normal distribution of a width of 1e-2 and 1e-3. The others get
100,000 points. Seconds and processor seconds (of all threads) per million points; each is the least of three. Ratios
of processor seconds say more where other work runs beside.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
import fast_simplification
import igl
import numpy as np
import trimesh

from cndhf_codec.decoder.queries import TriangleQueries
from cndhf_codec.decoder.queries.cells import CellGrid
from cndhf_codec.decoder.queries.tree import BoxTree
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.sampling import sample_surface

ROUNDS = 3
MOVED_BY = (1e-2, 1e-3)  # normalised units
OTHERS_POINTS = 100_000


class Cost(NamedTuple):
    """Seconds, and processor seconds, per point; or of all."""

    wall: float
    processors: float

    def beside(self, other: Cost) -> str:
        """Ours in microseconds, and how many times that the other takes."""
        return (
            f"{1e6 * self.wall:.3f} us (processors {1e6 * self.processors:.3f}); the other takes "
            f"{other.wall / self.wall:.2f} times that (processors {other.processors / self.processors:.2f})"
        )


def least_cost(work: Callable[[], Any], points: int = 1) -> Cost:
    costs = []
    for _ in range(ROUNDS):
        start = time.perf_counter(), time.process_time()
        work()
        costs.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    return Cost(min(c[0] for c in costs) / points, min(c[1] for c in costs) / points)


def load(path: Path, faces: int) -> trimesh.Trimesh:
    mesh = read_mesh(path)
    vertices, triangles = normalisation(mesh).apply(mesh.vertices), mesh.faces
    if len(triangles) > faces:
        vertices, triangles = fast_simplification.simplify(
            vertices.astype(np.float32), triangles.astype(np.int32), target_count=faces
        )
    return trimesh.Trimesh(vertices.astype(np.float64), triangles)


@click.command()
@click.argument("meshes", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--faces", default=50_000, show_default=True, help="Most faces of a mesh.")
@click.option("--points", default=1_000_000, show_default=True, help="Points of `contains`; a tenth for the others.")
def main(meshes: tuple[Path, ...], faces: int, points: int) -> None:
    """Time queries of MESHES."""
    for path in meshes:
        bench(path.stem, load(path, faces), points)


def bench(name: str, mesh: trimesh.Trimesh, points: int) -> None:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int64)
    cells, tree = (least_cost(lambda kind=kind: kind(vertices, faces)) for kind in (CellGrid, BoxTree))
    print(f"{name}: {len(faces)} faces, closed: {mesh.is_watertight}")
    for what, cost in (("cells", cells), ("tree", tree)):
        print(f"  {what} made in {cost.wall:.3f} s (processors {cost.processors:.3f})")
    rng = np.random.default_rng(0)
    on = sample_surface(vertices, faces, points, 0)
    sets = {"in the box": rng.uniform(*mesh.bounds, (points, 3))}
    sets |= {f"moved by {s:g}": on + rng.normal(size=on.shape) * s for s in MOVED_BY}
    for label, x in sets.items():
        print(f"  {label}:\n    contains {contains(mesh, x)}")
        few = x[: points // 10]
        print(f"    nearest {nearest(mesh, few)}")
        queries = TriangleQueries(vertices, faces)
        queries.distance(few)
        print(f"    distance {1e6 * least_cost(lambda q=queries, p=few: q.distance(p), len(few)).wall:.3f} us")
    print(f"  rays {rays(mesh, sets['in the box'][: points // 10])}")


def contains(mesh: trimesh.Trimesh, x: np.ndarray) -> str:
    some = x[:OTHERS_POINTS]
    mesh.contains(some[:10])  # its tree is made before the clock starts
    ours = least_cost(lambda: TriangleQueries(mesh.vertices, mesh.faces).contains(x), len(x))
    theirs = least_cost(lambda: mesh.contains(some), len(some))
    differ = (mesh.contains(some) != TriangleQueries(mesh.vertices, mesh.faces).contains(some)).sum()
    return f"{ours.beside(theirs)}; {differ} of {len(some)} differ"


def nearest(mesh: trimesh.Trimesh, x: np.ndarray) -> str:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int64)
    queries = TriangleQueries(vertices, faces)
    queries.nearest(x[:1])
    some = x[:OTHERS_POINTS]
    theirs = least_cost(lambda: igl.point_mesh_squared_distance(some, vertices, faces), len(some))
    off = np.abs(queries.nearest(some).distance - np.sqrt(igl.point_mesh_squared_distance(some, vertices, faces)[0]))
    return f"{least_cost(lambda: queries.nearest(x), len(x)).beside(theirs)}; differences up to {off.max():.1e}"


def rays(mesh: trimesh.Trimesh, targets: np.ndarray) -> str:
    directions = np.random.default_rng(1).normal(size=targets.shape)
    origins = targets - 2 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    queries = TriangleQueries(mesh.vertices, mesh.faces)
    queries.ray_intersect(origins[:1], directions[:1])
    ours = least_cost(lambda: queries.ray_intersect(origins, directions), len(origins))
    some = slice(OTHERS_POINTS)
    theirs = least_cost(
        lambda: mesh.ray.intersects_location(origins[some], directions[some], multiple_hits=False), len(origins[some])
    )
    return ours.beside(theirs)


if __name__ == "__main__":
    main()
