"""`meshio.read("x.cndhf")`, once this module is imported. meshio is not part of any extra: pip install meshio."""

from __future__ import annotations

import os
from typing import Any, BinaryIO

from ..decoder.model import load, load_stream
from ..errors import MissingExtraError

try:
    import meshio
except ImportError as exc:
    raise MissingExtraError("this needs meshio, which is not installed; run: pip install meshio") from exc


def read_cndhf(source: str | os.PathLike[str] | BinaryIO) -> Any:
    """meshio's reader of `.cndhf` files and streams: a `meshio.Mesh` of triangles, `Model.to_mesh()`'s.

    meshio passes no options on: for another resolution than 256 make the mesh with `Model.to_mesh`.
    Raises FormatError, InputError or SurfaceError.
    """
    model = load(source) if isinstance(source, (str, os.PathLike)) else load_stream(source, "the stream")
    mesh = model.to_mesh()
    return meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)])


meshio.register_format("cndhf", [".cndhf"], read_cndhf, {})
