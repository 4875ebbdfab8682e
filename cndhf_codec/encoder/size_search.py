"""Find the smallest file whose errors are within limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from ..errors import EncodeError
from ..mesh.distances import Distances
from ..mesh.lengths import Length

FIRST_SIZE, SMALLEST_SIZE, LARGEST_SIZE = 4096, 600, 24_576  # bytes of the first, smallest and largest file tried
TRIES = 6
SLOPE = 0.8  # log error falls so much per log bytes, before anything is known about the mesh
STEEP = 0.1  # of the limit: where less error is left, it has not fallen as a power, as with flat parts
CLOSE_ENOUGH = 1.05  # a file at most so many times as large as one that fails is small enough

Result = TypeVar("Result")


@dataclass(frozen=True)
class ErrorLimits:
    """The most mean and maximum error that a user asks for; None where nothing was said."""

    mean: Length | None
    maximum: Length | None

    @property
    def given(self) -> bool:
        return self.mean is not None or self.maximum is not None

    def excess(self, measured: Distances, diagonal: float) -> float:
        """How many times as large as its limit an error is, the worse of both. Input units."""
        pairs = ((self.mean, measured.mean), (self.maximum, measured.maximum))
        return max(error / limit.in_units(diagonal) for limit, error in pairs if limit is not None)

    def text(self, diagonal: float) -> str:
        """What was asked for, for messages."""
        pairs = ((self.mean, "mean"), (self.maximum, "maximum"))
        return " and ".join(
            f"a {name} error of {limit.in_units(diagonal):.4g}" for limit, name in pairs if limit is not None
        )


def smallest_file(attempt: Callable[[int, int], tuple[Result, float]], asked: str) -> Result:
    """Find the smallest size that keeps to the error asked for, and return its result.

    attempt: takes a size in bytes and how many attempts may still follow; returns a result, and how many times its
    error is what was asked for (see `ErrorLimits.excess`). asked: for the message. The error falls about as a power of
    the size. The next size is where that power, or the one through the nearest sizes on both sides of the limit, meets
    the limit; or in their middle, where that was wrong twice the same way, or is steep: from some size on, flat parts
    lose nothing. Raises EncodeError when the largest size does not meet it.
    """
    size, best = FIRST_SIZE, None
    fails, meets = (0, math.inf), (0, 0.0)  # largest size that fails, smallest that meets the limit; errors
    met: bool | None = None  # whether the last size met the limit
    for k in range(TRIES):
        try:
            result, error = attempt(size, TRIES - 1 - k)
        except EncodeError:  # of a size that holds nothing, or for want of time
            if best is None:
                raise
            break
        before, met = met, error <= 1
        if met:
            best, meets = result, (size, error)
        elif size > fails[0]:
            fails = (size, error)
        if best is None:
            if size == LARGEST_SIZE:
                break
            size = min(_at_limit(size, error, SLOPE, 1.25), LARGEST_SIZE)
        elif fails[0] == 0:
            if size == SMALLEST_SIZE:
                break
            size = max(min(_at_limit(size, error, SLOPE, 0.0), round(size / 1.1)), SMALLEST_SIZE)
        elif meets[0] <= CLOSE_ENOUGH * fails[0]:
            break
        elif met == before or meets[1] < STEEP:
            size = round(math.sqrt(fails[0] * meets[0]))
        else:
            slope = math.log(fails[1] / max(meets[1], 1e-9)) / math.log(meets[0] / fails[0])
            guess = _at_limit(meets[0], meets[1], max(slope, 0.1), 0.0)
            size = min(max(guess, round(fails[0] * 1.02)), round(meets[0] / 1.02))
    if best is None:
        raise EncodeError(
            f"{asked}, in input units, was not reached: it is {fails[1]:.3g} times as large at {fails[0]} bytes; allow "
            "more error, use a slower preset, or see whether parts of the surface are hidden"
        )
    return best


def _at_limit(size: int, error: float, slope: float, least: float) -> int:
    """Predict the size at which the error meets the limit, and a little more; at least `least` times this size."""
    factor = 1.02 * error ** (1 / slope)
    return round(size * min(max(factor, least), 100.0))
