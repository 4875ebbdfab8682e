"""Work on ranges of rows in threads: numpy's products and functions let others run while they do."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

# BLAS shares products of more multiplications than this out among threads of its own, which get in the way of ours.
PRODUCT = 2**18

_this_thread = threading.local()  # `.works`: it is one of those at work on ranges


def over_rows(work: Callable[[int, int], None], n: int, size: int) -> None:
    """Call work(first, last) for equal ranges of at most `size` rows that cover 0 to n, on every processor.

    There is one range for up to half of `size` rows, else an even number, so that two threads get as many. Let them
    be few and long: a thread that ends one of numpy's operations may have to wait for the interpreter's lock.
    The ranges do not depend on the number of processors, so neither does what `work` writes. What `work` calls in
    turn stays in its thread: threads of threads would get in each other's way. Raises what `work` raises.
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

    # The caller's thread works too: one fewer to start, and to wait for.
    others = [threading.Thread(target=run) for _ in range(threads - 1)]
    for thread in others:
        thread.start()
    run()
    for thread in others:
        thread.join()
    if errors:
        raise errors[0]


def product(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """a @ b for a (M, K) and b (K, N) with many columns, in this thread alone."""
    out = np.empty((len(a), b.shape[1]), dtype=np.result_type(a, b))
    columns = PRODUCT // a.size
    for first in range(0, b.shape[1], columns):
        part = slice(first, first + columns)
        np.matmul(a, b[:, part], out=out[:, part])
    return out


def processors() -> int:
    """How many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
