"""Work through jobs as tasks of a Ray cluster."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from typing import Any

from ..errors import EncodeError, OptionError, require
from .jobs import Job, Limits, Result
from .pool import TELL, Pool
from .worker import last_line

# Evidence for these constants: ADR 042.
RETRIES = 3  # of a file whose Ray worker or machine has gone
AHEAD = 2  # tasks for each processor of the cluster, so that none waits for this process
PATIENCE = 10  # seconds for the cluster to answer

_pools: dict[Limits, Pool] = {}  # of a Ray worker process: one, which stays warm from task to task


class OnRay:
    """Tasks of `limits.threads` processors each, wherever Ray puts them.

    Each Ray worker keeps a pool of one process, as on one machine: a mesh that crashes or exceeds a limit gives the
    same reason here as there.
    """

    def __init__(self, address: str, jobs: int | None, limits: Limits) -> None:
        """Raises OptionError where there is no cluster at the address."""
        self._ray: Any = require("ray", "cluster")
        self._jobs, self._limits = jobs, limits
        self._ours = not self._ray.is_initialized()
        if self._ours:
            quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
            try:
                if address == "local":
                    self._ray.init(
                        address="local", num_cpus=_processors(jobs, limits), include_dashboard=False, **quiet
                    )
                else:
                    _reach(address)
                    self._ray.init(address=address, **quiet)
            except (OSError, ValueError, RuntimeError) as exc:  # ConnectionError, too
                raise OptionError(
                    f"ray: no cluster at {address} ({_last(exc)}); start one with ray start --head, or use local; one "
                    "that asks for a token needs RAY_AUTH_MODE=token in the environment"
                ) from exc
        self._task = self._ray.remote(num_cpus=limits.threads, max_retries=RETRIES)(_encode)

    def results(self, jobs: Iterator[Job]) -> Iterator[Result | None]:
        """As `jobs.Runner`. Raises EncodeError where a task cannot run at all: a machine lacks the package."""
        ray = self._ray
        pending: dict[Any, Job] = {}
        while True:
            room = self._room()
            while len(pending) < room:
                job = next(jobs, None)
                if job is None:
                    break
                pending[self._task.remote(job, self._limits)] = job
            if not pending:
                return
            waited = list(pending)
            ready, _ = ray.wait(waited, timeout=TELL)
            if not ready:
                yield None
            elif len(waited) > 1:  # each wait looks at all of them: take what has ended together
                ready, _ = ray.wait(waited, num_returns=len(waited), timeout=0)
            for reference in ready:
                job = pending.pop(reference)
                try:
                    yield ray.get(reference)
                except ray.exceptions.RayTaskError as exc:
                    raise EncodeError(f"a Ray worker failed: {_last(exc)}") from exc
                except ray.exceptions.RayError as exc:
                    reason = f"its Ray worker ended, {RETRIES + 1} times: {_last(exc)}"
                    yield Result(job.name, "crashed", reason=reason)

    def _room(self) -> int:
        if self._jobs is not None:
            return self._jobs
        return max(int(AHEAD * self._ray.cluster_resources().get("CPU", 1)), 1)

    def close(self) -> None:
        if self._ours:
            self._ray.shutdown()


def _encode(job: Job, limits: Limits) -> Result:
    if limits not in _pools:
        _pools[limits] = Pool(1, limits)
    return next(result for result in _pools[limits].results(iter([job])) if result is not None)


def _reach(address: str) -> None:
    """Raise OSError where nothing answers: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()


def _processors(jobs: int | None, limits: Limits) -> int | None:
    return None if jobs is None else jobs * limits.threads


def _last(exc: Exception) -> str:
    return last_line(str(exc)) or type(exc).__name__
