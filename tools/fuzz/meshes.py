"""Coverage-guided fuzzing of the readers of mesh files with atheris: see README.md beside this file.

A finding is any exception but the package's own, any warning, more than 256 MB of memory, more than a second for a file
under 64 KB, or a mesh that is accepted and is none. Glue to Draco and meshoptimizer, which are libraries in C that
this package does not vouch for, is left out: `mesh_target.py` makes them unavailable.
"""

from __future__ import annotations

import atheris

with atheris.instrument_imports(include=["cndhf_codec.mesh"]):
    from cndhf_codec.mesh.read import Mesh

import measure
import mesh_mutate
import mesh_target
import numpy as np
from mesh_seeds import seeds
from watch import FindingError, Watch, run

SEEDS = seeds()
watch = Watch(measure.SUBJECTS["meshes"], slowest=0.8)


def one_input(data: bytes) -> None:
    watch.begin()
    try:
        mesh = mesh_target.read(data)
    except mesh_target.ALLOWED as exc:
        watch.end(False, data)
        check_line(str(exc))
        return
    watch.end(True, data)
    check(mesh)


def check(mesh: Mesh) -> None:
    """A mesh that is accepted has triangles of finite vertices that are there."""
    if mesh.vertices.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,) or not len(mesh.faces):
        raise FindingError(f"vertices {mesh.vertices.shape}, faces {mesh.faces.shape}")
    if not np.isfinite(mesh.vertices).all():
        raise FindingError("a vertex that is not finite")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise FindingError("a face of a vertex that is not there")
    for note in mesh.notes:
        check_line(note)


def check_line(text: str) -> None:
    """Messages go to terminals: one line, and nothing that a terminal obeys."""
    if not text.isprintable():
        raise FindingError(f"a message of several lines, or with control characters: {text!r}")


def custom_mutator(data: bytes, most: int, seed: int) -> bytes:
    return mesh_mutate.mutate(data, most, seed, lambda part, n: atheris.Mutate(part, min(n, most)), SEEDS)


if __name__ == "__main__":
    run(SEEDS, one_input, custom_mutator)
