"""The progress bar: one line for the whole encode, and a time left that can be believed."""

from __future__ import annotations

import io
import itertools
import json
import math
import os
from pathlib import Path

import pytest

from cndhf_codec.encoder import progress
from cndhf_codec.encoder.progress import COURSES, WORDS, Bar, Estimate

# Steps (seconds, stage, done, total) of encodes, the last where it ends: `tools/bench/time_left.py`.
MEASURED = json.loads((Path(__file__).parent / "progress_steps.json").read_text("utf-8"))


def walk(steps: list[list], at: float) -> Estimate:
    """An estimate when the share `at` of the time has passed."""
    estimate = Estimate(0.0)
    for when, stage, done, total in steps[:-1]:
        if when > at * steps[-1][0]:
            break
        estimate.update(stage, done, total, when)
    return estimate


@pytest.mark.parametrize("name", MEASURED)
@pytest.mark.parametrize("at", [0.25, 0.5, 0.75])
def test_the_time_left_is_within_a_third_of_the_truth(name, at):
    steps = MEASURED[name]
    whole = steps[-1][0]
    left = walk(steps, at).left(at * whole)
    if left is None:  # nothing is known of a surface before its first fit
        assert at * whole < 5
    else:  # whole seconds are shown
        assert left == pytest.approx((1 - at) * whole, rel=1 / 3, abs=1)


def test_the_share_done_only_grows():
    for steps in MEASURED.values():
        shares = [walk(steps, k / 40).done for k in range(41)]
        assert all(a <= b + 0.01 for a, b in itertools.pairwise(shares))
        assert shares[-1] == pytest.approx(1, abs=0.05)


def test_nothing_is_told_before_anything_is_known():
    estimate = Estimate(0.0)
    estimate.update("read", 0, 1, 0.0)
    assert estimate.left(1.0) is None
    estimate.update("a stage of another kind", 0, 2, 2.0)
    estimate.update("a stage of another kind", 1, 2, 4.0)
    assert estimate.left(4.0) == pytest.approx(2.0)
    assert estimate.left(5.0) == pytest.approx(1.0)
    estimate.update("a stage of another kind", 1, 2, 4.5)  # no further
    assert estimate.left(5.0) == pytest.approx(1.0)


def test_compiling_tells_nothing_about_the_rest():
    plain, compiled = Estimate(0.0), Estimate(0.0)
    for estimate in (plain, compiled):
        estimate.update("read", 1, 1, 1.0)
        estimate.update("simplify", 1, 1, 2.0)
        estimate.update("fit", 0, 100, 2.0)
    plain.update("fit", 30, 100, 12.0)
    compiled.update("compile", 0, 1, 3.0)
    compiled.update("compile", 1, 1, 53.0)
    compiled.update("fit", 0, 100, 53.0)
    assert compiled.left(53.0) is None
    compiled.update("fit", 30, 100, 62.0)
    compiled.update("compile", 0, 1, 62.0)
    assert compiled.left(65.0) is None
    compiled.update("compile", 1, 1, 72.0)
    assert compiled.left(72.0) == plain.left(12.0)
    assert compiled.done == plain.done


def test_uniting_parts_changes_no_course():
    plain, united = Estimate(0.0), Estimate(0.0)
    for estimate, stages in ((plain, ("read", "simplify", "fit")), (united, ("read", "unite", "simplify", "fit"))):
        for k, stage in enumerate(stages):
            estimate.update(stage, 1, 2, float(k))
    assert united.done == plain.done


def test_all_stages_have_words():
    assert {stage for course in COURSES for stage in course} | {"unite", "compile"} == set(WORDS)


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
    for stage in ("read", "axes", "plan", "compile", "fit", "joint fit", "round", "verify"):
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


@pytest.mark.parametrize(
    ("stages", "last"),
    [
        (("read", "axes", "verify", "axes", "compile", "verify"), "measuring, try 2"),
        (("read", "simplify", "verify", "simplify", "verify", "simplify"), "simplifying, try 3"),
        (("read", "simplify", "verify", "doubt", "axes", "plan"), "height fields: choosing views"),
        (("read", "simplify", "verify", "doubt", "axes", "verify", "axes"), "from all sides, try 2"),
        (("read", "simplify", "fit", "verify", "doubt"), " 98 %, asking whether height fields are better"),
    ],
)
def test_another_try_is_counted(stages, last):
    terminal = Terminal()
    bar = Bar(stream=terminal)
    for stage in stages:
        bar(stage, 0, 1)
    shown = terminal.getvalue()
    bar.close()
    assert shown.endswith(last)


class Closed:
    """Of a bar: what it is told when it waits, and is when it looks."""

    def __init__(self, *answers: bool) -> None:
        self._answers = list(answers)

    def wait(self, seconds: float) -> bool:
        return self._answers.pop(0)

    def is_set(self) -> bool:
        return False


def test_the_time_left_counts_down_between_steps(monkeypatch):
    clock = iter([0.0, 60.0, 65.0, 66.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    terminal = Terminal()
    bar = Bar(stream=terminal)
    bar("a stage", 0, 2)
    bar("a stage", 1, 2)
    bar._go_on(Closed(False, False, True))
    bar.close()
    lines = terminal.getvalue().split("\r\x1b[K")
    assert [line.split(",")[1] for line in lines if " left" in line] == [" 60 s left", " 55 s left", " 54 s left"]
    assert lines[-1] == ""


def test_silent_off_a_terminal():
    stream = io.StringIO()
    bar = Bar(stream=stream)
    bar("read", 0, 1)
    bar.close()
    assert stream.getvalue() == ""
