"""Find the smallest file whose error is within a limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from ..errors import EncodeError

FIRST_SIZE, SMALLEST_SIZE, LARGEST_SIZE = 4096, 600, 24_576  # bytes of the first, smallest and largest file tried
TRIES = 6
SLOPE = 0.8  # log error falls so much per log bytes, before anything is known about the mesh
CLOSE_ENOUGH = 1.05  # a file at most so many times as large as one that fails is small enough

Result = TypeVar("Result")


def smallest_file(attempt: Callable[[int, int], tuple[Result, float]], limit: float) -> Result:
    """Find the smallest size whose error is within the limit, and return its result.

    attempt: takes a size in bytes and how many attempts may still follow; returns a result and its error. The error
    falls about as a power of the size. The next size is where that power, or the one through the nearest sizes on both
    sides of the limit, meets the limit. Raises EncodeError when the largest size does not meet it.
    """
    size, best = FIRST_SIZE, None
    fails, meets = (0, math.inf), (0, 0.0)  # largest size that fails, smallest that meets the limit; errors
    for k in range(TRIES):
        result, error = attempt(size, TRIES - 1 - k)
        if error <= limit:
            best, meets = result, (size, error)
        elif size > fails[0]:
            fails = (size, error)
        if best is None:
            if size == LARGEST_SIZE:
                break
            size = min(_at_limit(size, error, SLOPE, limit, 1.25), LARGEST_SIZE)
        elif fails[0] == 0:
            if size == SMALLEST_SIZE:
                break
            size = max(min(_at_limit(size, error, SLOPE, limit, 0.0), round(size / 1.1)), SMALLEST_SIZE)
        elif meets[0] <= CLOSE_ENOUGH * fails[0]:
            break
        else:
            slope = math.log(fails[1] / max(meets[1], 1e-9 * limit)) / math.log(meets[0] / fails[0])
            guess = _at_limit(meets[0], meets[1], max(slope, 0.1), limit, 0.0)
            size = min(max(guess, round(fails[0] * 1.02)), round(meets[0] / 1.02))
    if best is None:
        raise EncodeError(
            f"the mean error asked for, {limit:.4g} in input units, was not reached: it is {fails[1]:.4g} at "
            f"{fails[0]} bytes; allow more error, use a slower preset, or see whether parts of the surface are hidden"
        )
    return best


def _at_limit(size: int, error: float, slope: float, limit: float, least: float) -> int:
    """Predict the size at which the error meets the limit, and a little more; at least `least` times this size."""
    factor = 1.02 * (error / limit) ** (1 / slope)
    return round(size * min(max(factor, least), 100.0))
