"""Checks of arguments: a wrong type or shape is an OptionError that says what is needed."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Iterator
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import OptionError


def whole_number(value: Any, name: str) -> int:
    """An int, of an int or a float that is one. Raises OptionError."""
    if isinstance(value, (float, np.floating)) and value.is_integer():
        return int(value)
    try:
        return operator.index(value)
    except TypeError:
        raise OptionError(f"{name} is {value!r}; a whole number is needed") from None


def whole_in(value: Any, name: str, least: int, most: int | None = None) -> int:
    """A whole number from `least` to `most`, inclusive. Raises OptionError."""
    if isinstance(value, bool):
        raise OptionError(f"{name} is {value!r}; a whole number is needed")
    number = whole_number(value, name)
    if number < least or (most is not None and number > most):
        allowed = f"{least} or more" if most is None else f"{least} to {most}"
        raise OptionError(f"{name} is {number}; {allowed} are allowed")
    return number


def positive(value: Any, name: str, unit: str) -> float:
    """A finite number above zero. Raises OptionError."""
    if not isinstance(value, Real) or isinstance(value, bool) or not 0 < float(value) < math.inf:
        raise OptionError(f"{name} is {value!r}; give a positive number of {unit}")
    return float(value)


def real_number(value: Any, name: str) -> Any:
    """The value itself, where it is a real number of any type. Raises OptionError."""
    if not isinstance(value, Real):
        raise OptionError(f"{name} is {value!r}; a number is needed")
    return value


def path_like(value: Any) -> str | os.PathLike[str]:
    """The value itself, where it is a path. Raises OptionError."""
    if not isinstance(value, (str, os.PathLike)):
        raise OptionError(f"a path is needed; got {type(value).__name__}")
    return value


def bytes_like(value: Any) -> bytes:
    """Bytes of an object that holds some. Raises OptionError."""
    if isinstance(value, bytes):
        return value
    try:
        return memoryview(value).tobytes()
    except TypeError:
        raise OptionError(f"the bytes of a .cndhf file are needed; got {type(value).__name__}") from None


def length(value: Any, diagonal: float, scale: float) -> float:
    """A positive length in normalised units, of a number of input units or "N%" of a diagonal in normalised units.

    Raises OptionError.
    """
    try:
        relative = str(value).strip().endswith("%")
        number = float(str(value).strip().removesuffix("%"))
    except ValueError:
        relative, number = False, 0.0
    if not 0 < number < np.inf:
        raise OptionError(
            f"max_error is {value!r}; give a positive number of input units, or one with % of the diagonal"
        )
    return number / 100 * diagonal if relative else number / scale


def vectors(values: npt.ArrayLike, n: int) -> npt.NDArray[Any]:
    """An array (..., n) of real numbers. Raises OptionError."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):  # lists of different lengths, tensors on a graphics card
        array = np.empty((), dtype=object)
    if array.dtype.kind not in "fiub":
        raise OptionError(f"an array of numbers of shape (..., {n}) is needed")
    if array.ndim == 0 or array.shape[-1] != n:
        raise OptionError(f"an array of shape (..., {n}) is needed; got {array.shape}")
    return array


def rows(array: npt.NDArray[Any], first: int, last: int) -> npt.NDArray[Any]:
    """Rows first to last of array.reshape(-1, n), which would copy an array that is not contiguous."""
    if array.ndim <= 2 or array.flags.c_contiguous:
        return array.reshape(-1, array.shape[-1])[first:last]
    return array[np.unravel_index(np.arange(first, last), array.shape[:-1])]


def chunks(n: int, size: int) -> Iterator[tuple[int, int]]:
    """Ranges (first, last) of at most `size` rows that cover 0 to n."""
    return ((first, min(first + size, n)) for first in range(0, n, size))
