"""`trimesh.load("x.cndhf")`, once this module is imported."""

from __future__ import annotations

from typing import Any, BinaryIO

from ..decoder.model import load_stream
from ..errors import require


def load_cndhf(
    file_obj: BinaryIO, file_type: str | None = None, resolution: int | None = None, **_: Any
) -> dict[str, Any]:
    """trimesh's loader of `.cndhf` streams: arguments of `trimesh.Trimesh`.

    resolution: as of `Model.to_mesh`; passed through from `trimesh.load("x.cndhf", resolution=128)`.
    Raises FormatError, OptionError or SurfaceError.
    """
    mesh = load_stream(file_obj, getattr(file_obj, "name", None) or "the stream").to_mesh(resolution)
    # process=False: merging vertices by position could weld parts of the surface that only touch.
    return {"vertices": mesh.vertices, "faces": mesh.faces, "process": False}


require("trimesh", "mesh")
mesh_loaders: dict[str, Any] = require("trimesh.exchange.load", "mesh").mesh_loaders
mesh_loaders["cndhf"] = load_cndhf
