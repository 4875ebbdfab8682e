"""Shares and counts as messages say them."""

from __future__ import annotations


def percent(share: float) -> str:
    """A share in words that do not make nothing of little."""
    return "under 0.1 %" if 0 < share < 0.001 else f"{100 * share:.1f} %"


def counted(number: int, word: str = "part") -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
