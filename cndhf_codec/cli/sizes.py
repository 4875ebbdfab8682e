"""Sizes as a user writes them."""

from __future__ import annotations

import re

from ..errors import OptionError


def parse_size(text: str) -> int:
    """Bytes of a size such as 4096, 4096B, 4KB, 4.5KiB or 1MB. Raises OptionError."""
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(B|KB|KiB|MB|MiB)?\s*", text, re.IGNORECASE)
    if match is None:
        raise OptionError(f"target size is {text!r}; give bytes, or a number with B, KB, KiB, MB or MiB")
    units = {"b": 1, "kb": 1000, "kib": 1024, "mb": 1000**2, "mib": 1024**2}
    return int(float(match[1]) * units[(match[2] or "B").lower()])
