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


def write_mesh(mesh: Any, path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Write a `trimesh.Trimesh`, whole or not at all. Raises OptionError or OutputError."""
    data = mesh.export(file_type=check_extension(path))
    write_atomically(path, data.encode() if isinstance(data, str) else data, overwrite)
