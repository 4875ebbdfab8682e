"""`meshio.read("x.cndhf")`, once this module is imported.

meshio belongs to no extra: pip install meshio.
"""

from __future__ import annotations

import os
from typing import Any, BinaryIO

from ..decoder.reading import load, load_stream
from ..errors import MissingExtraError

try:
    import meshio
except ImportError as exc:
    raise MissingExtraError("this needs meshio, which is not installed; run: pip install meshio") from exc


def read_cndhf(source: str | os.PathLike[str] | BinaryIO) -> Any:
    """meshio's reader of `.cndhf` files: the mesh of `Model.to_mesh()`.

    meshio passes no options on: for another resolution, use `Model.to_mesh` itself.

    Parameters
    ----------
    source : str, path-like or binary file object
        The file.

    Returns
    -------
    meshio.Mesh
        Triangles in input coordinates.

    Raises
    ------
    FormatError
        When it is not a valid file.
    InputError
        When it cannot be read.
    OptionError
        When it is neither a path nor a binary stream.
    SurfaceError
        When the solid is empty or too thin.

    Examples
    --------
    >>> import meshio
    >>> import cndhf_codec.integrations.meshio
    >>> meshio.read("tests/golden/encoded.cndhf").cells[0].type
    'triangle'
    """
    model = load(source) if isinstance(source, (str, os.PathLike)) else load_stream(source, "the stream")
    mesh = model.to_mesh()
    return meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)])


meshio.register_format("cndhf", [".cndhf"], read_cndhf, {})
