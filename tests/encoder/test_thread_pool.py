"""Threads that share work with the caller."""

from __future__ import annotations

import pytest

from cndhf_codec.encoder.thread_pool import ThreadPool


def test_a_pool_keeps_the_order_and_passes_errors_on():
    for threads in (1, 2, 3, 9):
        with ThreadPool(threads) as pool:
            assert pool.map(lambda x: x * x, range(7)) == [x * x for x in range(7)]
            with pytest.raises(ZeroDivisionError):
                pool.map(lambda x: 1 // x, [1, 2, 0, 3])
