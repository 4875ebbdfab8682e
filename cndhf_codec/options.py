"""Checks of arguments: a wrong type is an OptionError, as a value out of range is."""

from __future__ import annotations

import math
import numbers

from .errors import OptionError


def whole(what: str, value: object, least: int, most: int | None = None) -> int:
    """A whole number from `least` to `most`, inclusive. Raises OptionError."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool):
        raise OptionError(f"{what} is {value!r}; a whole number is needed")
    number = int(value)
    if number < least or (most is not None and number > most):
        allowed = f"{least} or more" if most is None else f"{least} to {most}"
        raise OptionError(f"{what} is {number}; {allowed} are allowed")
    return number


def positive(what: str, value: object, unit: str) -> float:
    """A finite number above zero. Raises OptionError."""
    if isinstance(value, numbers.Real) and not isinstance(value, bool) and 0 < float(value) < math.inf:
        return float(value)
    raise OptionError(f"{what} is {value!r}; give a positive number of {unit}")
