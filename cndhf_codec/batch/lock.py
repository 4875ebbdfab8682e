"""One run at a time on an output folder."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType

from ..errors import OutputError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Hold a lock, a file, that ends with the process whatever ends that.

    what: is in use, for the message. Raises OutputError where another process holds it.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as exc:
        raise OutputError(f"{path}: cannot be written: {exc.strerror}") from exc
    try:
        try:
            free = _take(file)
        except OSError as exc:
            raise OutputError(f"{path}: cannot be locked: {exc.strerror}; name a --manifest on another disk") from exc
        if not free:
            holder = ""
            with suppress(OSError):
                holder = os.read(file, 20).decode(errors="replace")
            raise OutputError(
                f"{what}: another cndhf-batch is at work on it{f' (process {holder})' if holder else ''}; wait for its "
                "end, or stop it"
            )
        os.ftruncate(file, 0)
        os.write(file, str(os.getpid()).encode())
        yield
    finally:
        os.close(file)


def _take(file: int) -> bool:
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            # A byte that is not written: Windows lets nobody else read what is locked.
            os.lseek(file, 1000, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            os.lseek(file, 0, os.SEEK_SET)
    except OSError as exc:
        if exc.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True
