"""Lists of different lengths, laid end to end: list i holds entries start[i] to start[i] + count[i] of one array."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...arrays import I64


class Entries(NamedTuple):
    """owner: which list each entry is of (N,). entry: its place in the array (N,)."""

    owner: I64
    entry: I64


def entries(start: I64, count: I64) -> Entries:
    """All entries of lists, list after list."""
    owner = np.repeat(np.arange(len(start)), count)
    before = np.cumsum(count) - count
    return Entries(owner, np.arange(len(owner)) + (start - before).take(owner))


def groups(count: I64, size: int) -> Iterator[tuple[int, int]]:
    """Ranges (first, last) of lists that together have at most `size` entries; one list may have more."""
    total = np.cumsum(count)
    first, done = 0, 0
    while first < len(count):
        last = max(int(np.searchsorted(total, done + size, side="right")), first + 1)
        yield first, last
        first, done = last, int(total[last - 1])
