"""Compiling is told of, and a clock stands meanwhile."""

from __future__ import annotations

import numba
import pytest

from cndhf_codec.encoder import compiling
from cndhf_codec.encoder.compiling import Compiling, told
from cndhf_codec.encoder.deadline import Deadline


def test_a_clock_stands_while_code_is_compiled(monkeypatch):
    now = 10.0
    monkeypatch.setattr(compiling.time, "monotonic", lambda: now)
    changes: list[bool] = []
    one = Compiling(changes.append)
    deadline = Deadline(40, one.now)
    now = 20.0
    one.start()
    now = 50.0
    one.start()  # of what the first calls
    assert (one.seconds, deadline.gone()) == (30, 10)
    one.end()
    now = 60.0
    one.end()
    now = 70.0
    assert changes == [True, False]
    assert one.seconds == 40
    assert deadline.gone() == pytest.approx(20)
    assert deadline.part(0.5).left() == pytest.approx(10)
    assert deadline.before(5).left() == pytest.approx(15)


def test_an_end_without_a_beginning_is_none():
    # Another encode of the process began to compile before this one listened.
    changes: list[bool] = []
    one = Compiling(changes.append)
    one.end()
    assert changes == []
    assert one.seconds == 0
    one.start()
    one.end()
    assert changes == [True, False]
    assert one.seconds < 1


def test_what_numba_compiles_is_told():
    changes: list[bool] = []
    one = Compiling(changes.append)
    double = numba.njit(lambda x: 2 * x)
    with told(one):
        assert double(3) == 6
        assert double(4) == 8  # compiled before
    assert changes == [True, False]
    assert one.seconds > 0
    assert double(2.5) == 5  # another type, and nobody is told
    assert changes == [True, False]
