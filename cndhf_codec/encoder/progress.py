"""Report the progress of a running encode."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any, Protocol

from ..errors import require


class Progress(Protocol):
    """A function called with the stage's name, the work done and the total work in it, and the fit's loss (else NaN).

    It may be called from several threads, never from two at once.
    """

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None: ...


OnStep = Callable[[int, float], None]  # steps done, loss
Stage = Callable[[str, int], OnStep]  # name and steps of a stage that starts -> its progress report


def silent(stage: str, done: int, total: int, loss: float = math.nan) -> None:
    """Report no progress."""


class Bar:
    """A progress bar on stderr, one line per stage: name, share done, time left, loss. Silent off a terminal."""

    def __init__(self, quiet: bool = False) -> None:
        self._on = not quiet and sys.stderr.isatty()
        self._stage = ""
        self._bar: Any = None

    def __call__(self, stage: str, done: int, total: int, loss: float = math.nan) -> None:
        if not self._on:
            return
        if stage != self._stage or (self._bar is None and done < total):  # a stage may be run again
            self.close()
            self._stage = stage
            form = "{desc:<9} {percentage:3.0f}%|{bar:30}| {elapsed}, {remaining} left{postfix}"
            tqdm = require("tqdm", "encode").tqdm
            self._bar = tqdm(desc=stage, total=total, file=sys.stderr, bar_format=form)
        if self._bar is None:
            return
        if not math.isnan(loss):
            self._bar.set_postfix_str(f"loss {loss:.2e}", refresh=False)
        self._bar.update(done - self._bar.n)
        if done >= total:  # what is printed next, such as a warning, gets a line of its own
            self.close()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
