"""Time limits of stages, as the share of the time that has passed."""

from __future__ import annotations

import math
import time


class Deadline:
    """A time limit of some seconds from now, by default infinitely many."""

    def __init__(self, seconds: float = math.inf) -> None:
        self._seconds = max(seconds, 1e-3)
        self._start = time.monotonic()

    def passed(self) -> float:
        """Share of the time that has passed: 1 or more when it is over, 0 without a limit."""
        return (time.monotonic() - self._start) / self._seconds

    def left(self) -> float:
        """Seconds left, 0 or more; infinite without a limit."""
        return max(self._seconds - (time.monotonic() - self._start), 0.0)

    def part(self, share: float) -> Deadline:
        """A deadline after that share of the time that is left."""
        return Deadline(share * (self._seconds - (time.monotonic() - self._start)))
