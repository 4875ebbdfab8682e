"""Where the error of a surface comes from: after each stage of the encoder, at one size.

    python tools/bench/error_budget.py OUT.tsv horse fandisk gears --size 2048 --preset default

CD in thousandths of the normalised frame, with samples that were not fitted: of the simplified mesh as a polyhedron, of
the limit surface after the fit with creases, after the edits, after rounding, and of the mesh that the file gives by
default. Those of the try that was kept. A mesh is a name of the corpus (CNDHF_CORPUS) or a path.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np

import cndhf_codec
from cndhf_codec.decoder.surface.levels import Level, next_level
from cndhf_codec.decoder.surface.subdivision import topology_of
from cndhf_codec.encoder.surface import encode, to_size
from cndhf_codec.format.container import rotation_matrix
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import Mesh, read_mesh

sys.path.insert(0, str(Path(__file__).parent))
from measure import Reference
from rate_distortion import mesh_path

LEVEL = 3  # of the meshes that stand for limit surfaces
COLUMNS = ("mesh", "bytes", "polyhedron", "fit", "edits", "rounding", "decoded")


class Stages:
    """Follows the encoder by the functions that it calls."""

    def __init__(self, reference: Reference, mesh: Mesh) -> None:
        self._reference, self._norm = reference, normalisation(mesh)
        self._by_faces: dict[bytes, dict[str, float]] = {}
        self.kept: dict[str, float] = {}
        self._rounded: list[tuple[Any, dict[str, float]]] = []
        self._rotation = np.eye(3)  # of the frame of the grid

    def _error(self, vertices: Any, faces: Any) -> float:
        given = self._norm.undo(vertices @ self._rotation)
        return self._reference.figures((given, faces))["CD"]

    def _limit_error(self, faces: Any, sharp: Any, control: Any) -> float:
        level = Level(0, topology_of(faces, len(control), sharp), control)
        for _ in range(LEVEL):
            level = next_level(level)
        return self._error(level.limit, level.topology.faces)

    def creases(self, function: Any) -> Any:
        def wrapped(mesh: Any, *rest: Any) -> Any:
            one = function(mesh, *rest)
            self._by_faces[mesh.faces.tobytes()] = {
                "polyhedron": self._error(mesh.vertices, mesh.faces),
                "fit": self._limit_error(mesh.faces, one.sharp, one.control),
            }
            return one

        return wrapped

    def edited(self, function: Any) -> Any:
        def wrapped(one: Any, mesh: Any, *rest: Any) -> Any:
            after, found = function(one, mesh, *rest)
            before = self._by_faces[mesh.faces.tobytes()]
            edits = self._limit_error(after.faces, found.sharp, found.control)
            self._by_faces[after.faces.tobytes()] = {**before, "edits": edits}
            return after, found

        return wrapped

    def rounded(self, function: Any) -> Any:
        def wrapped(one: Any, mesh: Any, target: Any, *rest: Any, **options: Any) -> Any:
            sized = function(one, mesh, target, *rest, **options)
            row = self._by_faces.get(mesh.faces.tobytes())
            if row is not None:
                rounding = self._limit_error(mesh.faces, one.sharp, sized.mesh.vertices)
                self._rounded.append((sized, {**row, "rounding": rounding}))
            return sized

        return wrapped

    def ended(self, function: Any) -> Any:
        def wrapped(*given: Any) -> Any:
            sized = function(*given)
            self.kept = next(row for made, row in self._rounded if made is sized)
            return sized

        return wrapped

    def turned(self, function: Any) -> Any:
        def wrapped(*given: Any) -> Any:
            quaternion = function(*given)
            if quaternion:
                self._rotation = rotation_matrix(quaternion)
            return quaternion

        return wrapped


def row(name: str, size: int, preset: str) -> str:
    mesh = read_mesh(mesh_path(name))
    reference = Reference(mesh)
    stages = Stages(reference, mesh)
    followed = {
        (to_size, "fit_with_creases"): stages.creases,
        (to_size, "edited"): stages.edited,
        (to_size, "on_grid"): stages.rounded,
        (encode, "surface_of_size"): stages.ended,
        (encode, "turned_frame"): stages.turned,
    }
    plain = {at: getattr(*at) for at in followed}
    try:
        for at, follow in followed.items():
            setattr(*at, follow(plain[at]))
        model = cndhf_codec.encode(mesh_path(name), preset=preset, target_size=size, representation="surface")
    finally:
        for at, function in plain.items():
            setattr(*at, function)
    out = model.to_mesh()
    decoded = reference.figures((out.vertices, out.faces))["CD"]
    figures = {**stages.kept, "decoded": decoded}
    return "\t".join(
        [name, str(len(model.dumps())), *(f"{figures[c]:.4g}" if c in figures else "-" for c in COLUMNS[2:])]
    )


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--size", default=2048, show_default=True, help="Bytes.")
@click.option("--preset", default="default", show_default=True)
def main(out: Path, names: tuple[str, ...], size: int, preset: str) -> None:
    """Write the table."""
    lines = ["\t".join(COLUMNS)]
    for name in names:
        lines.append(row(name, size, preset))
        print(lines[-1], flush=True)
        out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
    main()
