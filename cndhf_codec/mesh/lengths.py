"""Lengths and file sizes as a user writes them: "0.2%", "0.5mm", "4KiB"."""

from __future__ import annotations

import math
import numbers
import re
from dataclasses import dataclass

from ..errors import OptionError

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
BYTES = {"b": 1, "kb": 1000, "kib": 1024, "mb": 1000**2, "mib": 1024**2, "gb": 1000**3, "gib": 1024**3}


@dataclass(frozen=True)
class Length:
    """A length: in input units, or relative to the diagonal of the input's bounding box."""

    value: float
    relative: bool

    def in_units(self, diagonal: float) -> float:
        return self.value * diagonal if self.relative else self.value


def parse_length(text: str | float, unit: str | None, what: str) -> Length:
    """Parse a length as a user writes it.

    It is "0.2%" of the diagonal, a number in input units, or, where `unit` is the input's unit, "0.5mm", "0.1cm",
    "0.001m" or "0.02in". Raises OptionError, whose message calls the length `what`.
    """
    if unit is not None and unit not in METRES:
        raise OptionError(f"unit is {unit!r}; there are {', '.join(METRES)}")
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(%|[a-z]+)?\s*", str(text))
    value = float(match[1]) if match else 0.0
    if match is None or isinstance(text, bool) or not 0 < value < math.inf:
        raise OptionError(f"{what} is {text!r}; give a positive number, alone or with %, mm, cm, m or in")
    suffix = match[2]
    if suffix == "%":
        return Length(value / 100, relative=True)
    if suffix is None:
        return Length(value, relative=False)
    if suffix not in METRES:
        raise OptionError(f"{what} is {text!r}; units are {', '.join(METRES)}, or % of the diagonal")
    if unit is None:
        raise OptionError(f"{what} is {text!r}, but the input's unit is not known; state it with --unit")
    return Length(value * METRES[suffix] / METRES[unit], relative=False)


def parse_size(text: str | int, what: str = "target size") -> int:
    """Parse a size such as 4096, "4096", "4KB", "4.5KiB" or "1MB" to bytes.

    Raises OptionError, whose message calls the size `what`.
    """
    if isinstance(text, numbers.Integral) and not isinstance(text, bool):
        return int(text)
    match = None
    if isinstance(text, str):
        match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(B|KB|KiB|MB|MiB|GB|GiB)?\s*", text, re.IGNORECASE)
    if match is None:
        raise OptionError(f"{what} is {text!r}; give bytes, or a number with B, KB, KiB, MB, MiB, GB or GiB")
    return int(float(match[1]) * BYTES[(match[2] or "B").lower()])
