"""What meshes a file of a surface gives: triangles, megabytes as GLB with normals, errors.

    python tools/bench/decoded_mesh.py results/0.2/meshes.tsv FILES [MESHES]

MESHES are names of the corpus (CNDHF_CORPUS). FILES is a folder: NAME-SIZE.cndhf is made there, by preset `fast` as a
surface, where it is missing. Two tables, one below the other:

- `default`: the default mesh at each size; beside it `uniform`, the first level of which 99 % of the edges are within
  0.02 % of the diagonal, which was the default once.
- `faces`: meshes of 500 to 20,000 triangles, of `CUT` at the larger size; beside them `fast-simplification` of the
  finest level of at most 100,000 triangles (from more, it stops far above the number on fandisk), at the least
  aggressiveness of 3, 5 and 7 that reaches the number.

Errors are in percent of the input's diagonal. Rows that are there already are not made again.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import fast_simplification
import numpy as np

import cndhf_codec
from cndhf_codec.decoder.meshfile import mesh_bytes
from cndhf_codec.mesh.distances import surface_distances
from cndhf_codec.mesh.read import read_mesh

sys.path.insert(0, str(Path(__file__).parent))
from rate_distortion import mesh_path

MESHES = (
    "horse", "fandisk", "armadillo", "gears", "sts3215-servo", "spot", "rocker-arm", "lucy", "adis16480",
    "centauro-wheel", "vase-goblet",
)  # fmt: skip
SIZES = (1024, 4096)
CUT, COUNTS = ("horse", "fandisk", "gears", "vase-goblet"), (500, 1000, 2000, 5000, 10_000, 20_000)
COLUMNS = ("table", "file", "way", "triangles", "megabytes", "mean", "p99", "maximum")
SAMPLES = 100_000  # of either surface


class Table:
    """Rows, written as they are made."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._there = set()
        if path.exists():
            self._there = {tuple(line.split("\t")[:3]) for line in path.read_text("utf-8").splitlines()}
        else:
            path.write_text("\t".join(COLUMNS) + "\n", encoding="utf-8")

    def add(self, key: tuple[str, str, str], original: Any, make: Callable[[], Any]) -> None:
        """Make and measure a mesh, unless its row is there."""
        if key in self._there:
            return
        mesh = make()
        found = surface_distances(
            original.vertices, original.faces, np.asarray(mesh.vertices), np.asarray(mesh.faces), samples=SAMPLES
        )
        diagonal = float(np.linalg.norm(np.ptp(original.vertices, axis=0)))
        errors = [f"{100 * value / diagonal:.5f}" for value in (found.mean, found.p99, found.maximum)]
        megabytes = len(mesh_bytes(mesh, "glb", with_normals=True)[0]) / 1e6
        line = "\t".join([*key, str(len(mesh.faces)), f"{megabytes:.3f}", *errors])
        print(line, flush=True)
        with self._path.open("a", encoding="utf-8") as out:
            out.write(line + "\n")


def uniform(model: Any) -> Any:
    """The default mesh of the past."""
    for number in range(7):
        level = model._shape._at(number, model.limits)
        diagonal = np.linalg.norm(np.ptp(level.limit, axis=0))
        if np.quantile(level.distances.edges, 0.99) <= 2e-4 * diagonal or 4 * len(level.topology.faces) > 2**19:
            break
    return model.to_mesh(level=number, normals=True)


def by_fast_simplification(model: Any, faces: int) -> Any:
    import trimesh

    number = int(np.log(1e5 / model.info["faces"]) / np.log(4))
    fine = model.to_mesh(level=min(number, 6))
    for aggressiveness in (3, 5, 7):
        vertices, triangles = fast_simplification.simplify(
            np.asarray(fine.vertices, dtype=np.float32),
            np.asarray(fine.faces, dtype=np.int32),
            target_count=faces,
            agg=aggressiveness,
        )
        if len(triangles) <= 1.05 * faces:
            break
    return trimesh.Trimesh(vertices, triangles, process=False)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("files", type=click.Path(path_type=Path, file_okay=False))
@click.argument("names", nargs=-1)
def main(out: Path, files: Path, names: tuple[str, ...]) -> None:
    """Write the tables."""
    files.mkdir(parents=True, exist_ok=True)
    table = Table(out)
    for name in names or MESHES:
        original = read_mesh(mesh_path(name))
        for size in SIZES:
            path = files / f"{name}-{size}.cndhf"
            if not path.exists():
                made = cndhf_codec.encode(mesh_path(name), preset="fast", target_size=size, representation="surface")
                made.save(path)
            model = cndhf_codec.load(path)
            table.add(("default", path.stem, "uniform"), original, lambda m=model: uniform(m))
            table.add(("default", path.stem, "default"), original, lambda m=model: m.to_mesh(normals=True))
            if name not in CUT or size != SIZES[-1]:
                continue
            for n in COUNTS:
                table.add(("faces", path.stem, f"{n}"), original, lambda m=model, n=n: m.to_mesh(faces=n, normals=True))
                table.add(
                    ("faces", path.stem, f"{n} fast-simplification"),
                    original,
                    lambda m=model, n=n: by_fast_simplification(m, n),
                )


if __name__ == "__main__":
    warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
    main()
