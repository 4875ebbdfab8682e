"""How many threads the compiled code of this room uses: as many as the encode may."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numba as nb


@contextmanager
def compiled_threads(threads: int) -> Iterator[None]:
    """Let compiled code use so many threads, or all where there are fewer."""
    before = nb.get_num_threads()
    nb.set_num_threads(min(threads, nb.config.NUMBA_NUM_THREADS))
    try:
        yield
    finally:
        nb.set_num_threads(before)
