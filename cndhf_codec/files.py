"""Read and write files: whole or not at all, with errors that name the file."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType

from .errors import InputError, OutputError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


STREAM = Path("-")  # an argument of a command that stands for the standard input or output
PIECE = 2**20


def read_bytes(path: str | os.PathLike[str], limit: int) -> bytes:
    """Read at most the first `limit` bytes of a file. Raises InputError."""
    out = bytearray()
    try:
        with open(path, "rb") as file:
            # In pieces: one call would take `limit` bytes of memory for the smallest of files.
            while piece := file.read(min(PIECE, limit - len(out))):
                out += piece
        return bytes(out)
    except OSError as exc:
        raise InputError(f"{Path(path)}: cannot be read: {exc.strerror}") from exc


def check_output(path: str | os.PathLike[str], overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Raise OutputError when `path` could not be written, or is one of the inputs, which are never replaced. For use
    before any work is done."""
    target = Path(path)
    try:
        folder = target.absolute().parent
        is_folder, has_folder, exists = target.is_dir(), folder.is_dir(), target.exists()
        is_file = target.is_file()
        is_input = exists and any(source.exists() and target.samefile(source) for source in inputs)
    except (OSError, ValueError) as exc:  # a name too long, a folder that may not be looked into, a zero byte
        raise OutputError(f"{target}: cannot be written: {getattr(exc, 'strerror', exc)}") from exc
    if is_folder:
        raise OutputError(f"{target}: is a folder; name a file")
    if not has_folder:
        raise OutputError(f"{target}: the folder does not exist; make it first")
    if not os.access(folder, os.W_OK):
        raise OutputError(f"{target}: the folder may not be written to; choose another")
    if is_input:
        raise OutputError(f"{target}: is the input itself, which would be lost; name another output")
    if exists and not is_file:  # a rename would put a file in the place of a device
        raise OutputError(f"{target}: is no regular file; name another, or - for the standard output")
    if exists and not overwrite:
        raise OutputError(f"{target}: exists already; pass --overwrite (overwrite=True) to replace it")


def write_atomically(path: str | os.PathLike[str], data: bytes, overwrite: bool) -> None:
    """Write to a temporary file beside `path`, then rename it: readers see the old file or the new one.

    A process that is killed meanwhile leaves its temporary file, `.<16 hexadecimal digits>.cndhf.tmp`; the next write
    to that folder removes it (not on Windows, where it stays). Raises OutputError.
    """
    check_output(path, overwrite)
    target = Path(path)
    folder = target.absolute().parent
    _remove_leftovers(folder)
    # Not the tempfile module: its files are private to their owner, and so would the result be. The target's
    # name is left out: together they could be longer than a name may be.
    temporary = folder / f".{os.urandom(8).hex()}.cndhf.tmp"
    try:
        with open(temporary, "xb") as file:
            with suppress(OSError):  # a file system without locks, where no run can take this for a leftover
                _lock(file.fileno())
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            if fcntl is not None:  # under the lock, or else another run could take the file for a leftover
                os.replace(temporary, target)
        if fcntl is None:  # Windows renames no open file
            os.replace(temporary, target)
    except OSError as exc:
        raise OutputError(f"{target}: cannot be written: {exc.strerror}") from exc
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _lock(file: int) -> None:
    """Mark an open file as in use by this process, until it is closed. Raises OSError when another one uses it."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _remove_leftovers(folder: Path) -> None:
    """Remove temporary files of killed runs: those that no living process has locked."""
    if fcntl is None:
        return
    with suppress(OSError):  # a folder that may be written but not listed; a file that is in use, or another's
        for leftover in folder.glob(f".{'[0-9a-f]' * 16}.cndhf.tmp"):
            with suppress(OSError):
                file = os.open(leftover, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    _lock(file)
                    status = os.fstat(file)
                    # An empty file may belong to a process that is about to lock it.
                    if status.st_size or time.time() - status.st_mtime > 60:
                        leftover.unlink()
                finally:
                    os.close(file)
