"""The progress bar: one line for the whole encode, and a time left that can be believed."""

from __future__ import annotations

import io
import itertools
import math
import os

import pytest

from cndhf_codec.encoder import progress
from cndhf_codec.encoder.progress import COURSES, WORDS, Bar, Estimate


def walk(seconds: dict[str, float], at: float) -> Estimate:
    """An estimate when the share `at` of the time has passed, if each stage goes on evenly."""
    now, end = 0.0, at * sum(seconds.values())
    estimate = Estimate(0.0)
    for stage, long in seconds.items():
        for k in range(21):
            if now + long * k / 20 > end:
                return estimate
            estimate.update(stage, k / 20, now + long * k / 20)
        now += long
    return estimate


# Seconds of each stage, as measured on two busy cores: `model.report.seconds`.
ENCODES = {
    "horse fast": {"read": 1.9, "axes": 4.8, "fit": 24.3, "joint fit": 31.5, "round": 8.4, "verify": 1.3},
    "horse default": {
        "read": 1.4,
        "axes": 3.2,
        "plan": 98.9,
        "fit": 41.4,
        "joint fit": 317.6,
        "round": 180.9,
        "verify": 5.7,
    },
    "fandisk fast, surface": {"read": 0.2, "simplify": 0.1, "fit": 40.4, "verify": 0.9},
    "horse default, surface": {"read": 1.0, "simplify": 0.3, "fit": 30.0, "verify": 2.1},
}


@pytest.mark.parametrize("name", ENCODES)
@pytest.mark.parametrize("at", [0.25, 0.5, 0.75])
def test_the_time_left_is_within_a_third_of_the_truth(name, at):
    seconds = ENCODES[name]
    whole = sum(seconds.values())
    left = walk(seconds, at).left(at * whole)
    assert left is not None
    assert left == pytest.approx((1 - at) * whole, rel=1 / 3)


def test_the_share_done_only_grows():
    shares = [walk(ENCODES["horse fast"], k / 40).done for k in range(41)]
    assert all(a <= b + 0.01 for a, b in itertools.pairwise(shares))
    assert shares[-1] == pytest.approx(1, abs=0.05)


def test_nothing_is_told_before_anything_is_known():
    estimate = Estimate(0.0)
    estimate.update("read", 0.0, 0.0)
    assert estimate.left(1.0) is None
    estimate.update("a stage of another kind", 0.0, 2.0)
    estimate.update("a stage of another kind", 0.5, 4.0)
    assert estimate.left(4.0) == pytest.approx(2.0)
    assert estimate.left(5.0) == pytest.approx(1.0)


def test_uniting_parts_changes_no_course():
    plain, united = Estimate(0.0), Estimate(0.0)
    for estimate, stages in ((plain, ("read", "simplify", "fit")), (united, ("read", "unite", "simplify", "fit"))):
        for k, stage in enumerate(stages):
            estimate.update(stage, 0.5, float(k))
    assert united.done == plain.done


def test_all_stages_have_words():
    assert {stage for course in COURSES for stage in course} | {"unite"} == set(WORDS)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("columns", [20, 40, 60, 80, 120])
@pytest.mark.parametrize("verbose", [False, True])
def test_the_line_fits_the_terminal(monkeypatch, columns, verbose):
    clock = iter(range(10**6))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    monkeypatch.setattr(progress.shutil, "get_terminal_size", lambda _: os.terminal_size((columns, 24)))
    terminal = Terminal()
    bar = Bar(verbose=verbose, stream=terminal)
    for stage in ("read", "axes", "plan", "fit", "joint fit", "round", "verify"):
        for k in range(3):
            bar(stage, k, 2, math.nan if stage == "read" else 0.00123)
    bar.close()
    lines = terminal.getvalue().split("\r\x1b[K")[1:]
    assert all(len(line) < columns for line in lines)
    assert lines[-1] == ""
    assert verbose or "loss" not in terminal.getvalue()
    assert columns < 60 or ("loss 1.23e-03" in terminal.getvalue()) == verbose
    if columns >= 60:
        assert any(" 100 %" in line for line in lines)
        assert any("left, fitting" in line for line in lines)
        assert any(line.startswith("[#") for line in lines)


def test_another_try_is_counted(monkeypatch):
    terminal = Terminal()
    bar = Bar(stream=terminal)
    for stage in ("read", "axes", "verify", "axes", "verify"):
        bar(stage, 0, 1)
    assert "looking from all sides, try 2" in terminal.getvalue()


def test_silent_off_a_terminal():
    stream = io.StringIO()
    bar = Bar(stream=stream)
    bar("read", 0, 1)
    bar.close()
    assert stream.getvalue() == ""
