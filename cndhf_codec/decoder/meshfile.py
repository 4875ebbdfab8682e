"""Mesh files out, through trimesh."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import OptionError
from ..files import write_atomically

WITH_NORMALS = {"ply": "vertex_normal", "obj": "include_normals", "glb": "include_normals"}  # trimesh's options
EXTENSIONS = (".ply", ".obj", ".stl", ".off", ".glb")


def check_extension(path: str | os.PathLike[str]) -> str:
    """The format that a path's extension names, in lower case. Raises OptionError for one not written."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXTENSIONS:
        raise OptionError(f"{Path(path)}: unknown mesh extension; these are written: {', '.join(EXTENSIONS)}")
    return suffix[1:]


def check_normals(path: str | os.PathLike[str]) -> None:
    """Raises OptionError when the format of a path's extension holds no vertex normals."""
    if check_extension(path) not in WITH_NORMALS:
        raise OptionError(f"{Path(path)}: this format holds no vertex normals; .ply, .obj and .glb do")


def write_mesh(mesh: Any, path: str | os.PathLike[str], overwrite: bool = False, normals: bool = False) -> None:
    """Write a `trimesh.Trimesh`, whole or not at all; normals: with its vertex normals.

    Raises OptionError or OutputError.
    """
    extension = check_extension(path)
    if normals:
        check_normals(path)
    options = {WITH_NORMALS[extension]: normals} if extension in WITH_NORMALS else {}
    data = mesh.export(file_type=extension, **options)
    write_atomically(path, data.encode() if isinstance(data, str) else data, overwrite)
