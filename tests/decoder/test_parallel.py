"""Ranges of rows in threads."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from cndhf_codec.decoder import parallel
from cndhf_codec.decoder.parallel import over_rows


@pytest.mark.parametrize("processors", [1, 2, 5])
@pytest.mark.parametrize(("n", "parts"), [(0, 0), (1, 1), (5, 1), (6, 2), (10, 2), (21, 4), (1001, 102)])
def test_every_row_once_in_the_same_ranges(monkeypatch, processors, n, parts):
    monkeypatch.setattr(parallel, "processors", lambda: processors)
    seen, ranges = np.zeros(n, int), []

    def work(first: int, last: int) -> None:
        seen[first:last] += 1
        ranges.append((first, last))

    over_rows(work, n, 10)
    assert np.all(seen == 1)
    # About equally long, whatever the number of processors.
    assert sorted(ranges) == [(n * k // parts, n * (k + 1) // parts) for k in range(parts)]
    assert all(n // parts <= last - first <= 10 for first, last in ranges)


def test_work_within_work_stays_in_its_thread(monkeypatch):
    monkeypatch.setattr(parallel, "processors", lambda: 3)
    both_here = threading.Barrier(3, timeout=60)  # breaks unless three threads are at work
    homes = []

    def work(first: int, last: int) -> None:
        both_here.wait()
        here = threading.get_ident()
        over_rows(lambda *_: homes.append(threading.get_ident() == here), 20, 1)

    over_rows(work, 3, 1)
    assert homes == [True] * 60
    # And the caller's thread may start others again.
    over_rows(lambda *_: both_here.wait(), 3, 1)


@pytest.mark.parametrize("bad", [0, 7])
def test_an_error_is_raised_and_ends_the_work(monkeypatch, bad):
    monkeypatch.setattr(parallel, "processors", lambda: 2)

    def work(first: int, last: int) -> None:
        if first == bad:
            raise ValueError(f"row {first}")

    with pytest.raises(ValueError, match=f"row {bad}"):
        over_rows(work, 20, 1)
    over_rows(lambda *_: None, 20, 1)


def test_threads_are_limited_beside_the_processors(monkeypatch):
    monkeypatch.setattr(parallel, "_limit", None)
    all_of_them = parallel.processors()
    parallel.limit_threads(1)
    assert parallel.processors() == 1
    parallel.limit_threads(10**6)
    assert parallel.processors() == all_of_them
