"""The content of a mesh file: its own bytes, and those of the files that it names."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from ..errors import InputError
from ..files import PIECE
from ..mesh.formats.common import UnreadableError
from ..mesh.read import MOST_BYTES, unpacked


def check_regular(path: Path) -> os.stat_result:
    """The status of a regular file; a pipe would be waited for. Raises InputError."""
    try:
        status = path.stat()
    except (OSError, ValueError) as exc:  # no such file, a zero byte in its name
        raise InputError(f"{path}: cannot be read: {getattr(exc, 'strerror', exc)}") from exc
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: is no regular file, and is not read")
    return status


def hash_of(path: Path) -> str:
    """SHA-256 of a mesh file, and of the buffers that a .gltf names beside it. Raises InputError."""
    digest = hashlib.sha256()
    _add(digest, path)
    for name in beside(path):
        if (path.parent / name).is_file():
            _add(digest, path.parent / name)
    return digest.hexdigest()


def beside(path: Path) -> list[str]:
    """Names of the buffers that a .gltf has in its own folder and below it; none of another file. Raises InputError."""
    if ".gltf" not in PurePosixPath(path.name.lower()).suffixes:
        return []
    try:
        with open(path, "rb") as file:
            buffers = json.loads(unpacked(file.read(MOST_BYTES)))["buffers"]
        uris = [buffer["uri"] for buffer in buffers if "uri" in buffer]
    except OSError as exc:
        raise InputError(f"{path}: cannot be read: {exc.strerror}") from exc
    except (UnreadableError, ValueError, KeyError, TypeError):  # the reader will say what is wrong with it
        return []
    names = [unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]
    return [name for name in names if ":" not in name and ".." not in name.split("/") and not name.startswith("/")]


def _add(digest: hashlib._Hash, path: Path) -> None:
    try:
        with open(path, "rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
    except OSError as exc:
        raise InputError(f"{path}: cannot be read: {exc.strerror}") from exc
