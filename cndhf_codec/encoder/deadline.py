"""Time limits of stages, as the share of the time that has passed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable


class Deadline:
    """A time limit of some seconds from now, by default infinitely many. now: the clock, in seconds."""

    def __init__(self, seconds: float = math.inf, now: Callable[[], float] = time.monotonic) -> None:
        self._seconds, self._now = max(seconds, 1e-3), now
        self._start = now()

    def passed(self) -> float:
        """Share of the time that has passed: 1 or more when it is over, 0 without a limit."""
        return self.gone() / self._seconds

    def left(self) -> float:
        """Seconds left, 0 or more; infinite without a limit."""
        return max(self._seconds - self.gone(), 0.0)

    def gone(self) -> float:
        """Seconds since the start."""
        return self._now() - self._start

    def before(self, seconds: float) -> Deadline:
        """A deadline so many seconds earlier."""
        return Deadline(self._seconds - self.gone() - seconds, self._now)

    def part(self, share: float) -> Deadline:
        """A deadline after that share of the time that is left."""
        return Deadline(share * (self._seconds - self.gone()), self._now)


class Pace:
    """Tells whether a deadline leaves time for one more of what takes about equally long each time."""

    def __init__(self, deadline: Deadline) -> None:
        self._deadline, self._begin = deadline, deadline.gone()
        self.longest = 0.0  # seconds that one took; some are broken off

    def done(self) -> None:
        """To be called after each one."""
        end = self._deadline.gone()
        self.longest, self._begin = max(self.longest, end - self._begin), end

    @property
    def more(self) -> bool:
        """Whether there is time for another; before the first, whether there is any."""
        return self._deadline.left() > self.longest
