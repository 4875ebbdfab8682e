"""An adaptive binary range coder (Martin, 1979; carries and bytes as in LZMA), in integers below 2^32.

The state is an interval of numbers, split once per bit in proportion to the chance that its context gives a zero. A
context learns from the bits it has seen: after n bits, the next moves its chance by 1 / (n + 2) of the way (Krichevsky
and Trofimov, 1981), which is fast at first, because a small file shows each context few bits.

Encoder and decoder have the same two methods, `bit` and `raw`, and both return what was coded. Code that passes the
value along therefore works in either direction: the decoder ignores what it is given.
"""

from __future__ import annotations

from typing import Protocol

from ...errors import PayloadError, TruncatedError

ONE = 1 << 16  # probability 1
# A context's rate ends at 1 / (LIMIT + 2). Of 30, 62, 126, 254 the best for positions; marks would like less, by 1 %.
LIMIT = 62
TOP = 1 << 32  # numbers of the state are below
BOTTOM = 1 << 24  # the range is widened by a byte when it falls below
LOOKAHEAD = 4  # bytes that the decoder is ahead of the encoder; up to so many beyond the end are taken as 0


class Context:
    """One adaptive bit: the chance of a zero, times 2^16, and how many bits were seen, up to `LIMIT`.

    A coder's `bit` moves the chance. Both roundings are towards the old chance, so that it never reaches 0 or 1.

    >>> context = Context()
    >>> RangeEncoder().bit(context, 0)
    0
    >>> context.zero  # 3/4: half of the way from 1/2 to 1
    49152
    """

    __slots__ = ("count", "zero")

    def __init__(self, zero: int = ONE // 2, count: int = 0) -> None:
        self.zero = zero
        self.count = count


class Coder(Protocol):
    """What encoder and decoder have in common."""

    def bit(self, context: Context, bit: int = 0) -> int:
        """Code one bit with a context, and return it."""

    def raw(self, n_bits: int, value: int = 0) -> int:
        """Code `n_bits` bits that are all equally likely, the highest first, and return them as a number."""


class RangeEncoder:
    """Writes bits into bytes.

    >>> encoder = RangeEncoder()
    >>> encoder.raw(12, 0xABC)
    2748
    >>> encoder.finish().hex()
    'abc0'
    """

    def __init__(self) -> None:
        self._low = 0
        self._range = TOP - 1
        self._out = bytearray()

    def copy(self) -> RangeEncoder:
        """Another encoder that has coded the same."""
        other = RangeEncoder()
        other._low, other._range, other._out = self._low, self._range, self._out.copy()
        return other

    @property
    def state(self) -> tuple[int, int, int]:
        """The least number of the interval, how many there are, and the bytes that are out."""
        return self._low, self._range, len(self._out)

    def bit(self, context: Context, bit: int = 0) -> int:
        """Code one bit with a context, which learns it; return the bit."""
        zero, count = context.zero, context.count
        bound = (self._range >> 16) * zero
        if bit:
            self._low += bound
            self._range -= bound
            context.zero = zero - zero // (count + 2)
        else:
            self._range = bound
            context.zero = zero + (ONE - zero) // (count + 2)
        if count < LIMIT:
            context.count = count + 1
        if self._range < BOTTOM:
            self._widen()
        return bit

    def raw(self, n_bits: int, value: int = 0) -> int:
        """Code the lowest `n_bits` bits of a value, the highest first, all equally likely; return the value."""
        for k in range(n_bits - 1, -1, -1):
            bound = self._range >> 1
            if value >> k & 1:
                self._low += bound
                self._range -= bound
            else:
                self._range = bound
            if self._range < BOTTOM:
                self._widen()
        return value

    def finish(self) -> bytes:
        """The bytes: of all numbers in the interval the one that ends in most zero bytes, without these."""
        self._carry()
        self._low = _shortest(self._low, self._range)
        self._carry()
        if self._low:
            self._out.append(self._low >> 24)
        return bytes(self._out)

    def _widen(self) -> None:
        """Put out bytes until the range is wide enough again."""
        while self._range < BOTTOM:
            self._carry()
            self._out.append(self._low >> 24)
            self._low = self._low << 8 & TOP - 1
            self._range <<= 8

    def _carry(self) -> None:
        """Add what `low` has above 32 bits to the bytes that are out."""
        if self._low >= TOP:
            self._low -= TOP
            k = len(self._out) - 1
            while self._out[k] == 0xFF:
                self._out[k] = 0
                k -= 1
            self._out[k] += 1


def _shortest(low: int, width: int) -> int:
    """The number in [low, low + width) with most zeros at its end, by bytes; width is at least 2^24."""
    if low == 0 or low + width > TOP:
        return low and TOP
    return -(-low >> 24) << 24


class RangeDecoder:
    """Reads what `RangeEncoder` has written.

    >>> decoder = RangeDecoder(bytes.fromhex("abc0"))
    >>> decoder.raw(12)
    2748
    >>> decoder.finish()
    """

    def __init__(self, data: bytes) -> None:
        self._length = len(data)
        self._data = data + bytes(LOOKAHEAD)
        self._code = int.from_bytes(self._data[:LOOKAHEAD], "big")
        self._at = LOOKAHEAD  # the next byte to read
        self._range = TOP - 1

    def bit(self, context: Context, bit: int = 0) -> int:
        """Read one bit with a context, which learns it. Raises TruncatedError."""
        zero, count = context.zero, context.count
        width = self._range
        bound = (width >> 16) * zero
        if self._code < bound:
            width = bound
            context.zero = zero + (ONE - zero) // (count + 2)
            bit = 0
        else:
            self._code -= bound
            width -= bound
            context.zero = zero - zero // (count + 2)
            bit = 1
        if count < LIMIT:
            context.count = count + 1
        if width < BOTTOM:
            width = self._widen(width)
        self._range = width
        return bit

    def raw(self, n_bits: int, value: int = 0) -> int:
        """Read `n_bits` bits that are all equally likely, the highest first. Raises TruncatedError."""
        value = 0
        width = self._range
        for _ in range(n_bits):
            bound = width >> 1
            if self._code < bound:
                width = bound
                value <<= 1
            else:
                self._code -= bound
                width -= bound
                value = value << 1 | 1
            if width < BOTTOM:
                width = self._widen(width)
        self._range = width
        return value

    def finish(self) -> None:
        """Check that the bytes end here, just as the encoder would have ended them. Raises PayloadError."""
        last = int.from_bytes(self._data[self._at - LOOKAHEAD : self._at], "big")
        value = _shortest((last - self._code) % TOP, self._range) % TOP
        if last != value or self._length != self._at - LOOKAHEAD + (value > 0):
            raise PayloadError("the surface section goes on after its last symbol, or is damaged")

    def _widen(self, width: int) -> int:
        """Take in bytes until the range is wide enough again; return it."""
        while width < BOTTOM:
            if self._at == len(self._data):
                raise TruncatedError("the surface section ends inside its symbols")
            self._code = self._code << 8 | self._data[self._at]
            self._at += 1
            width <<= 8
        return width
