"""Report the progress of a running encode."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable
from typing import Protocol, TextIO


class Progress(Protocol):
    """A function called with the stage's name, the work done and the total work in it, and the fit's loss (else NaN).

    It may be called from several threads, never from two at once.
    """

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None: ...


OnStep = Callable[[int, float], None]  # steps done, loss
Stage = Callable[[str, int], OnStep]  # name and steps of a stage that starts -> its progress report


def silent(stage: str, done: int, total: int, loss: float = math.nan) -> None:
    """Report no progress."""


# Shares of an encode's time, of each stage in its order, in hundredths: measured on two cores, on meshes of 20,000 to
# 100,000 faces. What follows after which stage tells which row it is; until then it is the first.
COURSES = (
    {"read": 1, "axes": 1, "plan": 15, "fit": 6, "joint fit": 51, "round": 25, "verify": 1},
    {"read": 2, "axes": 6, "fit": 30, "joint fit": 45, "round": 15, "verify": 2},
    {"read": 1, "axes": 3, "fit": 94, "round": 1, "verify": 1},
    {"read": 2, "simplify": 2, "fit": 91, "verify": 5},
)
# What a user knows of the work.
WORDS = {
    "read": "reading the mesh",
    "unite": "uniting parts",
    "axes": "looking from all sides",
    "plan": "choosing views",
    "simplify": "simplifying",
    "fit": "fitting",
    "joint fit": "fitting together",
    "round": "rounding",
    "verify": "measuring",
}
LEAST_DONE = 0.05  # of the work, before which no time is told
SETTLED = 0.1  # share of a stage after which its own speed says how long it takes


class Estimate:
    """How much of an encode is done, and how long it will take, from the stages that have passed."""

    def __init__(self, now: float) -> None:
        self._start = self._stage_start = self._updated = now
        self._seen: list[str] = []
        self._fraction = 0.0

    def update(self, stage: str, fraction: float, now: float) -> None:
        """The stage that runs, and how much of it is done, 0 to 1; now: seconds."""
        stage = "read" if stage == "unite" else stage  # a part of some encodes alone, and about as long
        if not self._seen or self._seen[-1] != stage:
            self._seen.append(stage)
            self._stage_start = now
        self._fraction, self._updated = max(min(fraction, 1.0), 0.0), now

    @property
    def _course(self) -> dict[str, int]:
        def fits(course: dict[str, int]) -> bool:
            names = list(course)
            return all(s in names for s in self._seen) and all(
                a == b for a, b in zip(dict.fromkeys(self._seen), names, strict=False)
            )

        return next((course for course in COURSES if fits(course)), COURSES[0])

    def shares(self) -> tuple[float, float, float]:
        """Shares of the work: before this stage, in it, and after it."""
        course = self._course
        names = list(course)
        if not self._seen or self._seen[-1] not in names:
            return 0.0, 1.0, 0.0
        at, whole = names.index(self._seen[-1]), sum(course.values())
        parts = list(course.values())
        return sum(parts[:at]) / whole, parts[at] / whole, sum(parts[at + 1 :]) / whole

    @property
    def done(self) -> float:
        """Share of the whole work."""
        before, here, _ = self.shares()
        return before + here * self._fraction

    def left(self, now: float) -> float | None:
        """Seconds left; None while that cannot be told."""
        before, here, after = self.shares()
        done = before + here * self._fraction
        if done < LEAST_DONE:
            return None
        passed = self._updated - self._start
        scale = passed / done
        rest = scale * here * (1 - self._fraction)
        if self._fraction > SETTLED:
            own = (self._updated - self._stage_start) / self._fraction
            # The stages to come scale as this one, the longer it has run.
            scale += (own / here - scale) * min(here / (before + here), 1) * self._fraction
            rest = own * (1 - self._fraction)
        return max(rest + scale * after - (now - self._updated), 0.0)


class Bar:
    """One line on stderr for the whole encode: how much is done, the time left, what is being done. Silent off a
    terminal.

    verbose: the fit's loss, too.
    """

    def __init__(self, quiet: bool = False, verbose: bool = False, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._on = not quiet and self._stream.isatty()
        self._verbose = verbose
        self._estimate: Estimate | None = None
        self._tries, self._last, self._shown = 0, 0.0, ""

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None:
        if not self._on:
            return
        now = time.monotonic()
        if self._estimate is None:
            self._estimate, self._tries = Estimate(now), 1
        elif self._shown == "verify" and stage != "verify":  # another try, for an error that was asked for
            self._estimate, self._tries = Estimate(now), self._tries + 1
        new = stage != self._shown
        self._shown = stage
        self._estimate.update(stage, done / max(total, 1), now)
        if new or now - self._last > 0.1:
            self._last = now
            self._write(self.line(stage, now, loss, shutil.get_terminal_size((80, 24)).columns))

    def line(self, stage: str, now: float, loss: float, columns: int) -> str:
        """What is shown, within the width of a terminal."""
        assert self._estimate is not None
        left = self._estimate.left(now)
        word = WORDS.get(stage, stage) + (f", try {self._tries}" if self._tries > 1 else "")
        if self._verbose and not math.isnan(loss):
            word += f", loss {loss:.2e}"
        share = self._estimate.done
        tail = f" {100 * share:3.0f} %, {'' if left is None else f'{duration(left)} left, '}{word}"
        room = columns - 1 - len(tail)
        bar = ""
        if room >= 5:
            width = min(room - 2, 30)
            filled = round(width * share)
            bar = f"[{'#' * filled}{'.' * (width - filled)}]"
        return f"{bar}{tail}"[: columns - 1]

    def _write(self, text: str) -> None:
        self._stream.write(f"\r\x1b[K{text}")
        self._stream.flush()

    def close(self) -> None:
        """Clear the line: what is printed next begins there."""
        if self._on and self._estimate is not None:
            self._write("")
        self._estimate, self._shown = None, ""


def duration(seconds: float) -> str:
    """Write a time for people: 12 s, 3 min 05 s, 2 h 10 min."""
    whole = max(round(seconds), 1)
    return (
        f"{whole} s"
        if whole < 100
        else f"{whole // 60} min {whole % 60:02d} s"
        if whole < 3600
        else (f"{whole // 3600} h {whole % 3600 // 60:02d} min")
    )
