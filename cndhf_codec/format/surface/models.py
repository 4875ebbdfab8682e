"""Adaptive integers on top of the range coder.

Each model has one method, `code`, that both writes and reads: see `range_coder`. Small values are learnt one by one,
large ones by their number of binary digits and the two highest digits below the first.
"""

from __future__ import annotations

from ...errors import OptionError
from .range_coder import Coder, Context

MAX_DIGITS = 21  # binary digits of a value plus 1
MAX_VALUE = (1 << MAX_DIGITS) - 2
LEARNT = 2  # digits below the first that have contexts; the others are raw


class UnsignedModel:
    """Integers from 0 to `MAX_VALUE`: Elias' gamma code of the value plus 1, with a context for each place.

    Parameters
    ----------
    n_sets : int
        how many sets of contexts there are; `code` is told which one to use

    >>> from cndhf_codec.format.surface.range_coder import RangeDecoder, RangeEncoder
    >>> encoder, model = RangeEncoder(), UnsignedModel(2)
    >>> [model.code(encoder, 0, value) for value in (3, 0, 900)]
    [3, 0, 900]
    >>> decoder, model = RangeDecoder(encoder.finish()), UnsignedModel(2)
    >>> [model.code(decoder, 0) for _ in range(3)]
    [3, 0, 900]
    """

    def __init__(self, n_sets: int = 1) -> None:
        self._digits = [[Context() for _ in range(MAX_DIGITS)] for _ in range(n_sets)]
        self._below = [[Context() for _ in range(MAX_DIGITS << LEARNT)] for _ in range(n_sets)]

    def code(self, coder: Coder, chosen: int, value: int = 0) -> int:
        """Code a value with the chosen set of contexts; return it. Raises OptionError for one beyond `MAX_VALUE`."""
        if not 0 <= value <= MAX_VALUE:
            raise OptionError(f"a value of the surface section is {value}; 0 to {MAX_VALUE} can be coded")
        value += 1
        digits, target = 1, value.bit_length()
        for context in self._digits[chosen][1:]:  # "is there another digit?"; never asked after the last
            if not coder.bit(context, int(digits < target)):
                break
            digits += 1
        below, node = self._below[chosen], 1
        n_learnt = min(digits - 1, LEARNT)
        n_raw = digits - 1 - n_learnt
        for k in range(n_learnt):
            bit = value >> (digits - 2 - k) & 1
            node = node << 1 | coder.bit(below[(digits - 1) << LEARNT | node], bit)
        if n_raw:
            node = node << n_raw | coder.raw(n_raw, value & (1 << n_raw) - 1)
        return node - 1


class SignedModel:
    """Integers from `-MAX_VALUE - 1` to `MAX_VALUE + 1`: whether it is 0, its sign, then its magnitude less 1.

    Parameters
    ----------
    n_sets : int
        how many sets of contexts there are; `code` is told which one to use
    """

    def __init__(self, n_sets: int = 1) -> None:
        self._nonzero = [Context() for _ in range(n_sets)]
        self._negative = [Context() for _ in range(n_sets)]
        self._magnitude = UnsignedModel(n_sets)

    def code(self, coder: Coder, chosen: int, value: int = 0) -> int:
        """Code a value with the chosen set of contexts; return it. Raises OptionError for one out of range."""
        if not coder.bit(self._nonzero[chosen], int(value != 0)):
            return 0
        negative = coder.bit(self._negative[chosen], int(value < 0))
        magnitude = 1 + self._magnitude.code(coder, chosen, max(abs(value) - 1, 0))
        return -magnitude if negative else magnitude
