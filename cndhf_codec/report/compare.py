"""Measure distances between two shapes, each a mesh or a `.cndhf` file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import F64, I64
from ..decoder.model import Model
from ..decoder.reading import load
from ..errors import SurfaceError
from ..mesh.distances import Distances, surface_distances
from ..mesh.read import read_mesh

MEASURED_RESOLUTION = 384  # default resolution of the surface of double height fields
# The greatest, of the mesh of a subdivision surface: a level finer than the default, and 0.001 % on average.
MEASURED_ERROR = "0.02%"


@dataclass(frozen=True)
class Shape:
    """A surface: vertices (N, 3) float64 and triangles (M, 3) int64; the name of its file and the file's size in bytes;
    and notes, a line for each thing in it that was not read as it stands."""

    vertices: F64
    faces: I64
    name: str
    bytes: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Distances between two shapes, in input units. diagonal: of the bounding box of `a`, in input units."""

    a: Shape
    b: Shape
    diagonal: float
    distances: Distances

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON. Distances are in input units, and in percent of the diagonal in `percent`."""
        units = {
            "mean_error": self.distances.mean,
            "p99_error": self.distances.p99,
            "max_error": self.distances.maximum,
        }
        shapes = {
            key: {"name": s.name, "bytes": s.bytes, "vertices": len(s.vertices), "faces": len(s.faces)}
            for key, s in (("a", self.a), ("b", self.b))
        }
        return {
            **shapes,
            "diagonal": self.diagonal,
            **units,
            "percent": {key: 100 * value / self.diagonal for key, value in units.items()},
        }


def read_shape(path: str | os.PathLike[str], resolution: int | None = None) -> Shape:
    """Read the surface of a mesh file, or of a `.cndhf` file at a resolution (see `Model.to_mesh`), by default one that
    is fine enough for measuring.

    Raises InputError, MeshError, FormatError, OptionError or SurfaceError.
    """
    path = Path(path)
    notes: tuple[str, ...] = ()
    if path.suffix.lower() == ".cndhf":
        model = load(path)
        if resolution is None and model.representation == "dhf":
            vertices, faces = model.surface(MEASURED_RESOLUTION)
            vertices = vertices * model.container.scale + np.array(model.container.centre)
        else:
            surface = model.to_mesh(resolution) if resolution is not None else _fine_mesh(model)
            vertices, faces = np.asarray(surface.vertices), np.asarray(surface.faces, dtype=np.int64)
    else:
        mesh = read_mesh(path)
        vertices, faces, notes = mesh.vertices, mesh.faces, mesh.notes
    return Shape(vertices, faces, path.name, path.stat().st_size, notes)


def _fine_mesh(model: Model) -> Any:
    """The mesh of a subdivision surface, fine enough for measuring; the default one where no level is so fine."""
    try:
        return model.to_mesh(max_error=MEASURED_ERROR)
    except SurfaceError:
        return model.to_mesh()


def compare(a: Shape, b: Shape, seed: int = 0) -> Comparison:
    """Measure area-uniform samples of each surface against the other: see `mesh.distances.surface_distances`."""
    distances = surface_distances(a.vertices, a.faces, b.vertices, b.faces, seed)
    return Comparison(a, b, float(np.linalg.norm(np.ptp(a.vertices, axis=0))), distances)
