"""Floats of 16 bits: the upper half of a float32, with 8 significant bits. They are rounded up, never down."""

from __future__ import annotations

import struct

from ..errors import OptionError

INFINITY = 0x7F80  # as bits; what is larger is not a number, or negative


def bits_above(value: float) -> int:
    """The least bfloat16 that is not below a value, as an unsigned integer of 16 bits.

    >>> hex(bits_above(1.0)), hex(bits_above(1.0000000001)), bits_above(0.0)
    ('0x3f80', '0x3f81', 0)

    Raises OptionError for a value that is negative, not a number, or too large.
    """
    if not 0 <= value < 2.0**128:
        raise OptionError(f"{value} does not fit the format: it is negative, not a number, or too large")
    try:
        (bits,) = struct.unpack("<I", struct.pack("<f", value))
    except OverflowError:
        bits = INFINITY << 16
    # The float32 may be below the value, and then all of its lower half may be zero.
    upper = bits >> 16
    upper += from_bits(upper) < value
    if upper >= INFINITY:
        raise OptionError(f"{value} does not fit the format: it is too large")
    return upper


def from_bits(bits: int) -> float:
    """The value of a bfloat16 that is given by its bits."""
    (value,) = struct.unpack("<f", struct.pack("<I", bits << 16))
    return float(value)


def above(value: float) -> float:
    """The least bfloat16 that is not below a value. Raises OptionError as `bits_above` does.

    >>> above(0.1), above(0.5)
    (0.10009765625, 0.5)
    """
    return from_bits(bits_above(value))
