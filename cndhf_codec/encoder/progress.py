"""Report the progress of a running encode."""

from __future__ import annotations

import math
import shutil
import sys
import threading
import time
from collections.abc import Callable
from typing import Protocol, TextIO


class Progress(Protocol):
    """A function called with the stage's name, the work done and the total work in it, and the fit's loss (else NaN).

    It may be called from several threads, never from two at once. The stage "compile" interrupts another, which then
    goes on.
    """

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None: ...


OnStep = Callable[[int, float], None]  # steps done, loss
Stage = Callable[[str, int], OnStep]  # name and steps of a stage that starts -> its progress report


def silent(stage: str, done: int, total: int, loss: float = math.nan) -> None:
    """Report no progress."""


# How long each stage takes, in parts of the whole encode: measured, on meshes of 20,000 to 100,000 faces. What follows
# after which stage tells which row it is; until then it is the first. A stage of None takes as long as its own total
# says: the fit of a surface counts in rounds, and the others are about so many. ADR 044.
COURSES: tuple[dict[str, int | None], ...] = (
    {"read": 1, "axes": 1, "plan": 15, "fit": 6, "joint fit": 51, "round": 25, "verify": 1},
    {"read": 5, "axes": 5, "fit": 25, "joint fit": 37, "round": 15, "verify": 13},
    {"read": 1, "axes": 3, "fit": 94, "round": 1, "verify": 1},
    {"read": 4, "simplify": 5, "fit": None, "verify": 5},
    {"read": 4, "simplify": 5, "fit": None, "verify": 5, "doubt": 5},
)
# What a user knows of the work.
WORDS = {
    "compile": "compiling, this machine's first encode",
    "read": "reading the mesh",
    "unite": "uniting parts",
    "axes": "looking from all sides",
    "plan": "choosing views",
    "simplify": "simplifying",
    "fit": "fitting",
    "joint fit": "fitting together",
    "round": "rounding",
    "verify": "measuring",
    "doubt": "asking whether height fields are better",
}
CLEAR = "\r\x1b[K"  # to the beginning of a terminal's line, and what stands there goes
UNCOUNTED = 230  # rounds, of a fit that has not begun: of preset `default`
LEAST_DONE = 0.05  # of the work, before which no time is told
STEPS = 0.7  # of a stage's time
SETTLED = 0.1  # of the work in a stage, after which its own speed says how long the rest of it takes


class Estimate:
    """How much of an encode is done, and how long it will take, from the stages that have passed."""

    def __init__(self, now: float) -> None:
        self._start = self._stage_start = self._updated = now
        self._seen: list[str] = []
        self._fraction, self._total = 0.0, 1
        self._compiling: float | None = None  # since when

    def update(self, stage: str, done: int, total: int, now: float) -> None:
        """The stage that runs, and how much of it is done. now: seconds."""
        if stage == "compile":  # interrupts another, and says nothing about its speed
            if not done:
                self._compiling = now
            elif self._compiling is not None:
                long, self._compiling = now - self._compiling, None
                self._start, self._stage_start = self._start + long, self._stage_start + long
                self._updated += long
            return
        stage = "read" if stage == "unite" else stage  # a part of some encodes alone, and about as long
        if not self._seen or self._seen[-1] != stage:
            self._seen.append(stage)
            self._stage_start = now
        # Preparing and finishing take their part of a stage that is told in steps; one that counts rounds counts all.
        steps = 1.0 if self._course.get(stage) is None or total == 1 else STEPS
        fraction = min(steps * done / max(total, 1), 1.0)
        if fraction != self._fraction or fraction == 0:
            self._updated = now
        self._fraction, self._total = fraction, total

    def shares(self) -> tuple[float, float, float]:
        """Shares of the work: before this stage, in it, and after it."""
        course = self._course
        names = list(course)
        if not self._seen or self._seen[-1] not in names:
            return 0.0, 1.0, 0.0
        at = names.index(self._seen[-1])
        parts = [course[name] or self._counted for name in names]
        before = sum(part for name, part in zip(names[:at], parts, strict=False) if name in self._seen)
        whole = before + sum(parts[at:])
        return before / whole, parts[at] / whole, sum(parts[at + 1 :]) / whole

    @property
    def _course(self) -> dict[str, int | None]:
        seen = [name for name in dict.fromkeys(self._seen) if name != "read"]  # done once, whatever the tries
        return next((c for c in COURSES if [name for name in c if name != "read"][: len(seen)] == seen), COURSES[0])

    @property
    def _counted(self) -> int:
        """What a stage of None takes."""
        return self._total if self._course[self._seen[-1]] is None else UNCOUNTED

    @property
    def done(self) -> float:
        """Share of the whole work."""
        before, here, _ = self.shares()
        return before + here * self._fraction

    def left(self, now: float) -> float | None:
        """Seconds left; None while that cannot be told."""
        before, here, after = self.shares()
        done = before + here * self._fraction
        begun = self._fraction > 0 or self._course.get(self._seen[-1], 1) is not None
        if done < LEAST_DONE or not begun or self._compiling is not None:
            return None
        speed = own = (self._updated - self._start) / done  # seconds that the whole takes
        if self._fraction > 0:
            trust = min(here * self._fraction / SETTLED, 1)
            own += ((self._updated - self._stage_start) / (here * self._fraction) - own) * trust
        rest = own * here * (1 - self._fraction) - (now - self._updated)
        return max(rest, 0.0) + speed * after


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
        self._first, self._try, self._other, self._last = "", 1, False, 0.0
        self._shown, self._loss = "", math.nan
        self._lock, self._closed = threading.Lock(), threading.Event()

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None:
        if not self._on:
            return
        with self._lock:
            now = time.monotonic()
            if self._estimate is None:
                self._estimate = Estimate(now)
                self._closed = threading.Event()
                threading.Thread(target=self._go_on, args=(self._closed,), daemon=True).start()
            elif self._shown in ("verify", "doubt") and stage not in ("verify", "doubt", "compile"):
                # Another try, for an error that was asked for; or height fields, beside the surface that is there.
                self._estimate = Estimate(now)
                self._other = self._other or stage != self._first
                self._try, self._first = self._try + 1 if stage == self._first else 1, stage
            elif not self._first and stage in ("axes", "simplify"):
                self._first = stage
            new = stage != self._shown
            self._shown, self._loss = stage, loss
            self._estimate.update(stage, done, total, now)
            if new or now - self._last > 0.1:
                self._show(now)

    def _go_on(self, closed: threading.Event) -> None:
        """Count the time left down: a step may take long."""
        while not closed.wait(1):
            with self._lock:
                if not closed.is_set():
                    self._show(time.monotonic())

    def _show(self, now: float) -> None:
        self._last = now
        self._write(self.line(self._shown, now, self._loss, shutil.get_terminal_size((80, 24)).columns))

    def line(self, stage: str, now: float, loss: float, columns: int) -> str:
        """What is shown, within the width of a terminal."""
        assert self._estimate is not None
        left = self._estimate.left(now)
        word = "height fields: " if self._other else ""
        word += WORDS.get(stage, stage) + (f", try {self._try}" if self._try > 1 else "")
        if self._verbose and not math.isnan(loss):
            word += f", loss {loss:.2e}"
        share = self._estimate.done
        time_left = "" if left is None or left < 0.5 else f"{duration(left)} left, "
        tail = f" {100 * share:3.0f} %, {time_left}{word}"
        room = columns - 1 - len(tail)
        bar = ""
        if room >= 5:
            width = min(room - 2, 30)
            filled = round(width * share)
            bar = f"[{'#' * filled}{'.' * (width - filled)}]"
        return f"{bar}{tail}"[: columns - 1]

    def _write(self, text: str) -> None:
        self._stream.write(f"{CLEAR}{text}")
        self._stream.flush()

    def close(self) -> None:
        """Clear the line: what is printed next begins there."""
        with self._lock:
            self._closed.set()
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
