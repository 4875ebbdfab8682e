"""Encode one file after another, in a process of its own: imports and compiled code are paid for once."""

from __future__ import annotations

import gc
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import CndhfError, CndhfWarning, InputError
from ..files import write_atomically
from . import remote
from .content import beside, check_regular, hash_of
from .jobs import Job, Result

READY = "ready"  # the first message of a worker; then hashes (str) and results


def serve(connection: Connection, threads: int, log: str) -> None:
    """Work through the jobs that come through a connection, until it is closed.

    log: a file for what libraries say before they end the process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    with open(log, "wb") as file:
        os.dup2(file.fileno(), 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare(threads)
    connection.send(READY)
    frozen = False
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        connection.send(work(job, threads, connection.send))
        if not frozen:  # what the first file has loaded is here to stay: not to look at it again saves 6 %
            gc.collect()
            gc.freeze()
            frozen = True


def prepare(threads: int) -> None:
    """Import what an encode needs, and bound the threads of this process."""
    from threadpoolctl import threadpool_limits

    from ..decoder.parallel import limit_threads
    from ..encoder import pipeline  # noqa: F401

    limit_threads(threads)
    threadpool_limits(threads)


def _end_with_parent() -> None:
    """A worker whose parent was killed must not go on for minutes."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def work(job: Job, threads: int, announce: Callable[[str], Any] = lambda _: None) -> Result:
    """Encode one file and write its output.

    announce: is told the content's hash before the work begins that may end the process.
    """
    start = time.perf_counter()
    scratch = None
    content = ""

    def tell(found: str) -> None:
        nonlocal content
        content = found
        announce(found)

    try:
        if job.version != __version__:
            raise CndhfError(f"{job.name}: this worker has cndhf-codec {__version__}, not {job.version}; install that")
        if remote.is_url(job.source):
            scratch = Path(tempfile.mkdtemp(prefix="cndhf-"))
            result = _encoded(job, _fetched(job, scratch), threads, tell)
        else:
            result = _encoded(job, Path(job.source), threads, tell)
    except CndhfError as exc:
        reason = str(exc)
        if scratch is not None:  # name the file that the user knows
            reason = reason.replace(str(scratch / Path(job.source.partition("::")[0]).name), job.source)
        result = Result(job.name, "failed", reason=" ".join(reason.split()).removeprefix(f"{job.source}: "))
    except MemoryError:
        result = Result(job.name, "memory", reason="out of memory; use a smaller mesh, or more memory")
    except Exception as exc:  # a fault of this package or another: it must not end the batch
        result = Result(job.name, "failed", reason=f"unexpected {type(exc).__name__}: {' '.join(str(exc).split())}")
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)
    return replace(result, hash=content, seconds=time.perf_counter() - start)


def _encoded(job: Job, source: Path, threads: int, announce: Callable[[str], Any]) -> Result:
    from ..encoder.pipeline import encode

    before = check_regular(source)
    content = hash_of(source)
    announce(content)
    if content == job.known:
        return Result(job.name, "done", source_bytes=before.st_size, fresh=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CndhfWarning)  # the report has them
        model = encode(source, threads=threads, **job.options)
    after = check_regular(source)
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise InputError(f"{job.source}: changed while it was encoded; run again when it is whole")
    data = model.dumps()
    if job.target is not None:
        _write(job.target, data)
    report = model.report
    assert report.distances is not None
    return Result(
        job.name,
        "done",
        output=job.target or "",
        source_bytes=before.st_size,
        bytes=len(data),
        representation=report.representation,
        mean_error=report.distances.mean,
        p99_error=report.distances.p99,
        max_error=report.distances.maximum,
        diagonal=report.diagonal,
        warnings=tuple(report.warnings),
        data=data if job.target is None else None,
    )


def _write(target: str, data: bytes) -> None:
    if remote.is_url(target):
        remote.store(target, data)
        return
    with suppress(OSError):  # the write says what is wrong
        os.makedirs(os.path.dirname(target) or ".", exist_ok=True)
    write_atomically(target, data, overwrite=True)


def _fetched(job: Job, scratch: Path) -> Path:
    """Copy a file named by a URL, and those that it names, into a folder."""
    path = remote.fetch(job.source, scratch)
    for name in beside(path):
        (scratch / name).parent.mkdir(parents=True, exist_ok=True)
        remote.fetch(remote.beside(job.source, name), (scratch / name).parent)
    return path


def last_said(log: str) -> str:
    """The last line of what a worker's libraries said, or ""."""
    try:
        with open(log, "rb") as file:
            file.seek(max(os.path.getsize(log) - 2000, 0))
            return last_line(file.read().decode(errors="replace"))
    except OSError:
        return ""


def last_line(text: str) -> str:
    """The last line that is not empty, or ""; at most 200 characters of it."""
    lines = [line.strip() for line in text.split("\n") if line.strip()]
    return lines[-1][:200] if lines else ""
