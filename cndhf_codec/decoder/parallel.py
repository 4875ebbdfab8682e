"""Work on ranges of rows in threads: numpy's products and functions let others run while they do."""

from __future__ import annotations

import os
from collections.abc import Callable


def over_rows(work: Callable[[int, int], None], n: int, size: int) -> None:
    """Call work(first, last) for ranges of `size` rows that cover 0 to n, on every processor.

    The ranges do not depend on the number of processors, so neither does what `work` writes.
    """
    ranges = [(first, min(first + size, n)) for first in range(0, n, size)]
    threads = min(len(ranges), processors())
    if threads < 2:
        for first, last in ranges:
            work(first, last)
        return
    from concurrent.futures import ThreadPoolExecutor  # here: it costs a program that only loads a file too much

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda r: work(*r), ranges):  # what a thread raises is raised here
            pass


def processors() -> int:
    """How many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
