"""Write shares and counts for messages."""

from __future__ import annotations


def percent(share: float) -> str:
    """Write a share in percent; small shares are "under 0.1 %", never "0.0 %"."""
    return "under 0.1 %" if 0 < share < 0.001 else f"{100 * share:.1f} %"


def counted(number: int, word: str = "part") -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
