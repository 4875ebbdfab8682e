"""Work on ranges of rows in threads: numpy's products and functions let other threads run meanwhile."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

# Evidence for these constants: ADR 028.
#
# BLAS divides products of more multiplications than this among threads of its own, which compete with ours.
MULTIPLICATIONS_IN_ONE_THREAD = 2**18

_limit: int | None = None  # of the threads, beside the number of processors
_this_thread = threading.local()  # `.works`: whether this thread is at work in `over_rows`


def over_rows(work: Callable[[int, int], None], n: int, size: int) -> None:
    """Call work(first, last) for ranges that cover rows 0 to n, in a thread per processor.

    The ranges have nearly the same length, at most `size` rows. Up to size / 2 rows are one range; more rows are an
    even number of ranges, so that two threads get the same share. Ranges should be few and long: a thread that has
    finished one of numpy's operations may have to wait for the interpreter's lock.

    The ranges, and so what `work` writes, do not depend on the number of processors. An `over_rows` within `work`
    runs in its own thread only: nested threads would compete for the processors. Raises what `work` raises.
    """
    parts = min(n, 2 * -(-n // (2 * size)) if n > size // 2 else 1)
    ranges = iter([(n * k // parts, n * (k + 1) // parts) for k in range(parts)])
    threads = 1 if getattr(_this_thread, "works", False) else min(parts, processors())
    if threads < 2:
        for first, last in ranges:
            work(first, last)
        return
    lock = threading.Lock()
    errors: list[BaseException] = []

    def run() -> None:
        _this_thread.works = True
        try:
            while not errors:
                with lock:
                    part = next(ranges, None)
                if part is None:
                    break
                work(*part)
        except BaseException as exc:  # raised again by the caller's thread
            errors.append(exc)
        finally:
            _this_thread.works = False

    # The caller's thread works too, so one thread fewer has to be started.
    others = [threading.Thread(target=run) for _ in range(threads - 1)]
    for thread in others:
        thread.start()
    run()
    for thread in others:
        thread.join()
    if errors:
        raise errors[0]


def matmul(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """a @ b for a (M, K) and b (K, N) with many columns, without the threads of BLAS."""
    out = np.empty((len(a), b.shape[1]), dtype=np.result_type(a, b))
    columns = MULTIPLICATIONS_IN_ONE_THREAD // a.size
    for first in range(0, b.shape[1], columns):
        part = slice(first, first + columns)
        np.matmul(a, b[:, part], out=out[:, part])
    return out


def limit_threads(most: int) -> None:
    """Let this process use at most so many threads; other processes have the other processors."""
    global _limit
    _limit = most


def processors() -> int:
    """How many processors this process may use."""
    try:
        allowed = len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        allowed = os.cpu_count() or 1
    return allowed if _limit is None else min(allowed, _limit)
