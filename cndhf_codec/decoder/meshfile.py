"""Mesh files out, through trimesh."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import OptionError
from ..files import write_atomically

EXTENSIONS = (".ply", ".obj", ".stl", ".off", ".glb")


def check_extension(path: str | os.PathLike[str]) -> str:
    """The format that a path's extension names, in lower case. Raises OptionError for one not written."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXTENSIONS:
        raise OptionError(f"{Path(path)}: unknown mesh extension; these are written: {', '.join(EXTENSIONS)}")
    return suffix[1:]


def mesh_bytes(mesh: Any, extension: str) -> bytes:
    """The bytes of a mesh file; extension: one of `EXTENSIONS` without its dot."""
    data = mesh.export(file_type=extension)
    return data.encode() if isinstance(data, str) else bytes(data)


def write_mesh(mesh: Any, path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Write a `trimesh.Trimesh`, whole or not at all. Raises OptionError or OutputError."""
    write_atomically(path, mesh_bytes(mesh, check_extension(path)), overwrite)
