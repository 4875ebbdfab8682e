"""Reading and writing files: whole or not at all, with errors that name the file."""

from __future__ import annotations

import os
from pathlib import Path

from .errors import InputError, OutputError


def read_bytes(path: str | os.PathLike[str], limit: int = -1) -> bytes:
    """The first `limit` bytes of a file (all of it by default). Raises InputError."""
    try:
        with open(path, "rb") as file:
            return file.read(limit)
    except OSError as exc:
        raise InputError(f"{Path(path)}: cannot be read: {exc.strerror}") from exc


def check_output(path: str | os.PathLike[str], overwrite: bool) -> None:
    """Raise OutputError, before any work is done, when `path` could not be written at the end."""
    target = Path(path)
    try:
        is_folder, has_folder, exists = target.is_dir(), target.absolute().parent.is_dir(), target.exists()
    except OSError as exc:  # a name too long, a folder that may not be looked into
        raise OutputError(f"{target}: cannot be written: {exc.strerror}") from exc
    if is_folder:
        raise OutputError(f"{target}: is a folder; name a file")
    if not has_folder:
        raise OutputError(f"{target}: the folder does not exist; make it first")
    if exists and not overwrite:
        raise OutputError(f"{target}: exists already; pass --overwrite (overwrite=True) to replace it")


def write_atomically(path: str | os.PathLike[str], data: bytes, overwrite: bool) -> None:
    """Write to a temporary file beside `path`, then rename it: readers see the old file or the new one."""
    check_output(path, overwrite)
    target = Path(path)
    # Not the tempfile module: its files are private to their owner, and so would the result be. The target's
    # name is left out: together they could be longer than a name may be.
    temporary = target.absolute().parent / f".{os.urandom(8).hex()}.cndhf.tmp"
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as exc:
        raise OutputError(f"{target}: cannot be written: {exc.strerror}") from exc
    finally:
        temporary.unlink(missing_ok=True)
