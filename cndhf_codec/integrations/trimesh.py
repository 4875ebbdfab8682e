"""`trimesh.load("x.cndhf")`, once this module is imported."""

from __future__ import annotations

from typing import Any, BinaryIO

from ..decoder.reading import load_stream
from ..errors import require


def load_cndhf(
    file_obj: BinaryIO,
    file_type: str | None = None,
    resolution: int | None = None,
    level: int | None = None,
    **_: Any,
) -> dict[str, Any]:
    """trimesh's loader of `.cndhf` streams: the mesh of `Model.to_mesh`.

    Parameters
    ----------
    file_obj : binary file object
        Open for reading.
    file_type : str, optional
        Given by trimesh, and not used.
    resolution : int, optional
        Of double height fields, as for `Model.to_mesh`; `trimesh.load("x.cndhf", resolution=128)` passes it on.
    level : int, optional
        Of surfaces, likewise.

    Returns
    -------
    dict
        Arguments of `trimesh.Trimesh`, in input coordinates.

    Raises
    ------
    FormatError
        When the stream does not hold a valid file.
    OptionError
        When it is no binary stream, or the resolution or the level is out of range.
    SurfaceError
        When the solid is empty or too thin.

    Examples
    --------
    >>> import trimesh
    >>> import cndhf_codec.integrations.trimesh
    >>> trimesh.load_mesh("tests/golden/encoded.cndhf", resolution=16).is_watertight
    True
    """
    mesh = load_stream(file_obj, getattr(file_obj, "name", None) or "the stream").to_mesh(resolution, level=level)
    # process=False: merging vertices by position could weld parts of the surface that only touch.
    return {"vertices": mesh.vertices, "faces": mesh.faces, "process": False}


require("trimesh", "mesh")
mesh_loaders: dict[str, Any] = require("trimesh.exchange.load", "mesh").mesh_loaders
mesh_loaders["cndhf"] = load_cndhf
