"""A pool of worker processes that outlives their deaths.

Not `concurrent.futures`: there the death of one process ends the pool and all of its work.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from ..errors import EncodeError, OptionError, require
from .jobs import Job, Limits, Outcome, Result
from .worker import READY, last_said, serve

# Evidence for these constants: ADR 042.
LOOK = 0.1  # seconds between two looks at the workers' memory
TELL = 1.0  # seconds of silence after which `results` gives a sign of life
# Libraries read these when they are loaded. IGL: libigl's own threads.
THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
    "IGL_NUM_THREADS",
)


class Pool:
    """`jobs` processes, each with one file at a time.

    A file that ends its process, or that is ended for its memory or its time, costs nothing but itself. Where the
    process had worked on other files before, which may have left it damaged or large, a file that crashes it or exceeds
    the memory gets a second try in a new one.
    """

    def __init__(self, jobs: int, limits: Limits) -> None:
        if limits.memory is not None:
            require("psutil", "encode")
        self._limits = limits
        self._folder = Path(tempfile.mkdtemp(prefix="cndhf-batch-"))
        self._workers: list[_Worker | None] = [None] * jobs

    def results(self, jobs: Iterator[Job]) -> Iterator[Result | None]:
        """Take jobs as there are free workers, and yield results as they end; None now and then while all work.

        Raises EncodeError where a worker cannot start, and OptionError where it needs more memory than it may have
        before it has any work.
        """
        told = time.monotonic()
        while True:
            for k, worker in enumerate(self._workers):
                if worker is None or worker.job is None:
                    job = next(jobs, None)
                    if job is None:
                        break
                    self._give(k, job)
            busy = [(k, w) for k, w in enumerate(self._workers) if w is not None and w.job is not None]
            if not busy:
                return
            self._wait([w for _, w in busy])
            for k, worker in busy:
                result = worker.outcome()
                if result is None and worker.over_limit():
                    result = worker.outcome()
                if result is None:
                    continue
                job = worker.take()
                if not worker.alive and worker.done > 1 and result.outcome in ("crashed", "memory"):
                    self._give(k, job)
                    continue
                yield result
                told = time.monotonic()
            if time.monotonic() - told > TELL:
                yield None
                told = time.monotonic()

    def _give(self, k: int, job: Job) -> None:
        """Give a job to a worker, or to a new one in its place where it has died."""
        worker = self._workers[k]
        if worker is None or not worker.alive:
            worker = self._workers[k] = _Worker(self._limits, self._folder / f"{k}.log")
        worker.give(job)

    def _wait(self, busy: list[_Worker]) -> None:
        """Wait until a worker has said something or died, or may have exceeded a limit."""
        watched: list[Any] = [*(w.connection for w in busy), *(w.process.sentinel for w in busy)]
        patience = LOOK if self._limits.memory is not None else TELL
        if self._limits.timeout is not None:
            patience = min([patience, *(w.time_left() for w in busy)])
        wait(watched, max(patience, 0.0))

    def close(self) -> None:
        for worker in self._workers:
            if worker is not None:
                worker.end()
        self._workers = [None] * len(self._workers)
        shutil.rmtree(self._folder, ignore_errors=True)


class _Worker:
    """A process, and the job that it works on."""

    def __init__(self, limits: Limits, log: Path) -> None:
        self._limits, self._log = limits, str(log)
        self.job: Job | None = None
        self.done = 0  # jobs that it has had
        self._ready, self._started, self._hash = False, 0.0, ""
        self._over: tuple[Outcome, str] | None = None
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self.connection, other = context.Pipe()
        self.process = context.Process(target=serve, args=(other, limits.threads, self._log), daemon=True)
        with _environment(limits.threads), _no_interrupts():
            self.process.start()
        other.close()  # or else the end of the process would not close the connection

    @property
    def alive(self) -> bool:
        return self.process.is_alive()

    def give(self, job: Job) -> None:
        self.job, self._started, self._hash = job, time.monotonic(), ""
        with suppress(OSError):  # it has died meanwhile: its end will be seen
            self.connection.send(job)

    def take(self) -> Job:
        """The job, which the worker no longer has."""
        assert self.job is not None
        job, self.job = self.job, None
        self.done += 1
        return job

    def time_left(self) -> float:
        """Seconds; the start of a worker is not the mesh's fault."""
        if self._limits.timeout is None or not self._ready:
            return float("inf")
        return self._limits.timeout - (time.monotonic() - self._started)

    def over_limit(self) -> bool:
        """End the process, and return True, where it exceeds a limit."""
        memory = self._limits.memory
        if memory is not None and (used := self._memory()) > memory:
            self.end()
            if not self._ready:
                raise OptionError(
                    f"memory is {memory} bytes, but a worker takes {used} before it has any work; allow more"
                )
            self._over = "memory", f"took {used / 1e9:.2f} GB of memory, over the {memory / 1e9:.2f} of --memory"
        elif self.time_left() <= 0:
            self.end()
            self._over = "timeout", f"took longer than the {self._limits.timeout:g} s of --timeout"
        return self._over is not None

    def _memory(self) -> int:
        import psutil

        try:
            return int(psutil.Process(self.process.pid).memory_info().rss)
        except psutil.Error:  # it has just ended
            return 0

    def outcome(self) -> Result | None:
        """What became of the job; None while it goes on."""
        assert self.job is not None
        try:
            while self._over is None and self.connection.poll():
                message = self.connection.recv()
                if isinstance(message, Result):
                    return message
                if message == READY:
                    self._ready, self._started = True, time.monotonic()
                else:
                    self._hash = message
        except (EOFError, OSError):
            self.process.join(10)
        if self._over is None and self.alive:
            return None
        self.process.join()
        if self._over is None and not self._ready:
            raise EncodeError(f"a worker cannot start: {last_said(self._log) or _end(self.process.exitcode)}")
        outcome, reason = self._over or ("crashed", self._crash())
        seconds = time.monotonic() - self._started
        return Result(self.job.name, outcome, reason=reason, seconds=seconds, hash=self._hash)

    def _crash(self) -> str:
        said = last_said(self._log)
        return f"ended its process: {_end(self.process.exitcode)}{f' ({said})' if said else ''}"

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _end(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """Bound the threads that libraries of a new process bring."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Let a new process ignore Ctrl-C from its first moment on: its parent ends it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
