"""Codec 2 of weights: range asymmetric numeral systems (Duda, 2013) with a rounded Gaussian per tensor.

Integers only, so that every machine decodes the same symbols. A symbol is coded as the bucket of its magnitude, by the
tensor's frequency table; then the bits below the bucket, all equally likely; then its sign, if it is not zero. A tensor
whose symbols start at 0 or above and never fall is coded as its differences, without signs.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice

import numpy as np
import numpy.typing as npt

from ..errors import LimitError, OptionError, PayloadError
from .constants import MAX_SYMBOL

SCALE_CODES = 60  # scale code c: standard deviation 2^(c / 4 - 2)
BUCKETS = 64  # the last one is the escape, which 16 bits of magnitude follow
ESCAPE = BUCKETS - 1
RISING = 0x80  # set on the scale code of a tensor that is coded as differences
TOTAL_BITS = 14  # frequencies of a table add up to 2^14
LOW = 2**23  # the state lies in [LOW, 256 LOW) between symbols
# Most symbols of a section: so many, and so many more per byte of it. Otherwise a small file could ask for much work.
# The free ones are for small networks whose weights are nearly all zero.
FREE_SYMBOLS, MAX_SYMBOLS_A_BYTE = 2**15, 4

# The ratios of a Gaussian's successive values, at steps of 1, are a geometric sequence. Row t holds its first term and
# its ratio, times 2^24. Rows 0 to 23: standard deviation 2^(t / 4 - 2), values at 0, 1, 2, ... Rows 24 to 27: standard
# deviation of row t - 4, values at 0.5, 1.5, 2.5, ...
RATIOS: tuple[tuple[int, int], ...] = (
    (5628, 2),
    (58611, 205),
    (307285, 5628),
    (991630, 58611),
    (2270549, 307285),
    (4078822, 991630),
    (6171993, 2270549),
    (8272320, 4078822),
    (10175896, 6171993),
    (11780768, 8272320),
    (13066109, 10175896),
    (14058751, 11780768),
    (14805841, 13066109),
    (15357953, 14058751),
    (15760736, 14805841),
    (16051906, 15357953),
    (16261035, 15760736),
    (16410554, 16051906),
    (16517109, 16261035),
    (16592872, 16410554),
    (16646655, 16517109),
    (16684790, 16592872),
    (16711808, 16646655),
    (16730939, 16684790),
    (16517109, 16517109),
    (16592872, 16592872),
    (16646655, 16646655),
    (16684790, 16684790),
)

Symbols = npt.NDArray[np.int32]


def low_bits(scale_code: int) -> int:
    """How many bits of a magnitude lie below its bucket."""
    return max(0, scale_code // 4 - 5)


@lru_cache(maxsize=SCALE_CODES)
def frequencies(scale_code: int) -> tuple[int, ...]:
    """The frequency table of a scale code: `BUCKETS` numbers, each at least 1, that add up to 2^14."""
    wide = scale_code >= 24
    ratio, change = RATIOS[24 + scale_code % 4 if wide else scale_code]
    value = 1 << 24
    weights = [value if wide else value >> 1]  # zero has one sign only
    for _ in range(1, ESCAPE):
        value = value * ratio >> 24
        ratio = ratio * change >> 24
        weights.append(value)
    weights.append(0)
    total = sum(weights)
    table = [1 + w * ((1 << TOTAL_BITS) - BUCKETS) // total for w in weights]
    table[0] += (1 << TOTAL_BITS) - sum(table)
    return tuple(table)


@lru_cache(maxsize=SCALE_CODES)
def _starts(scale_code: int) -> tuple[int, ...]:
    out, total = [], 0
    for f in frequencies(scale_code):
        out.append(total)
        total += f
    return tuple(out)


@lru_cache(maxsize=SCALE_CODES)
def _lookup(scale_code: int) -> bytes:
    return bytes(np.repeat(np.arange(BUCKETS, dtype=np.uint8), frequencies(scale_code)))


def encoded_size(tensors: list[Symbols]) -> float:
    """Bytes of the section, to within about two, without coding it."""
    return len(tensors) + 4 + sum(_cheapest(*_values(t))[0] for t in tensors) / 8


def _values(tensor: Symbols) -> tuple[npt.NDArray[np.int64], bool]:
    """The flat values that are coded for a tensor, and whether they are its differences."""
    flat = tensor.astype(np.int64).ravel()
    differences = np.diff(flat, prepend=0)
    rising = bool((differences >= 0).all())
    return (differences if rising else flat), rising


def _cheapest(values: npt.NDArray[np.int64], rising: bool) -> tuple[float, int]:
    """Bits of a tensor at the scale code that takes the fewest, and that code."""
    magnitude = np.abs(values)
    signs = 0 if rising else np.count_nonzero(magnitude)
    return min((_bits(magnitude, code) + signs, code) for code in range(SCALE_CODES))


def _bits(magnitude: npt.NDArray[np.int64], code: int) -> float:
    low = low_bits(code)
    bucket = np.minimum(magnitude >> low, ESCAPE)
    cost = TOTAL_BITS - np.log2(np.array(frequencies(code), dtype=np.float64))
    return float(cost[bucket].sum() + np.where(bucket == ESCAPE, 16, low).sum())


def encode(tensors: list[Symbols]) -> bytes:
    """The section's bytes: a scale code per tensor, the state as u32, then the bytes that the decoder shifts in.

    Raises OptionError for a symbol beyond `MAX_SYMBOL`.
    """
    codes = bytearray()
    steps: list[tuple[int, int, int]] = []  # start, frequency, bits of the total
    for tensor in tensors:
        if np.abs(tensor).max() > MAX_SYMBOL:
            raise OptionError(f"a symbol is larger than {MAX_SYMBOL}; use a coarser step")
        values, rising = _values(tensor)
        code = _cheapest(values, rising)[1]
        codes.append(code | (RISING if rising else 0))
        low, table, starts = low_bits(code), frequencies(code), _starts(code)
        for s in values.tolist():
            magnitude = abs(s)
            bucket = min(magnitude >> low, ESCAPE)
            steps.append((starts[bucket], table[bucket], TOTAL_BITS))
            if bucket == ESCAPE:
                steps.append((magnitude >> 8, 1, 8))
                steps.append((magnitude & 0xFF, 1, 8))
            elif low:
                steps.append((magnitude & ((1 << low) - 1), 1, low))
            if magnitude and not rising:
                steps.append((int(s < 0), 1, 1))
    state, out = LOW, bytearray()
    for start, frequency, bits in reversed(steps):
        limit = (LOW >> bits << 8) * frequency
        while state >= limit:
            out.append(state & 0xFF)
            state >>= 8
        state = (state // frequency << bits) + start + state % frequency
    return bytes(codes) + state.to_bytes(4, "little") + bytes(reversed(out))


class EndedError(PayloadError):
    """Raised when the section's bytes are used up before its symbols are complete."""


def decode(body: bytes, sizes: list[int]) -> list[Symbols]:
    """Flat symbols of tensors with these sizes. Raises LimitError or PayloadError."""
    if sum(sizes) > _most_symbols(body):
        raise LimitError(
            f"the weights have {len(body)} bytes for {sum(sizes)} symbols; at most {FREE_SYMBOLS} and "
            f"{MAX_SYMBOLS_A_BYTE} for each byte are allowed"
        )
    try:
        return list(_decoded(body, sizes))
    except EndedError as exc:  # a private class: only `decode_prefix` goes on after it
        raise PayloadError(str(exc)) from None


def decode_prefix(body: bytes, sizes: list[int], first: int) -> list[Symbols]:
    """Of the first `first` tensors, those that a section holds that is cut off anywhere. Raises PayloadError."""
    tensors: list[Symbols] = []
    allowed = _most_symbols(body)
    try:
        for tensor in islice(_decoded(body, sizes), first):
            allowed -= tensor.size
            if allowed < 0:
                break
            tensors.append(tensor)
    except EndedError:
        pass
    return tensors


def _most_symbols(body: bytes) -> int:
    return FREE_SYMBOLS + MAX_SYMBOLS_A_BYTE * len(body)


def _decoded(body: bytes, sizes: list[int]) -> Iterator[Symbols]:
    """Yield the tensors in turn, and check the section's end after the last one."""
    if len(body) < len(sizes) + 4:
        raise EndedError("the weights end inside their scale codes")
    codes = body[: len(sizes)]
    largest = max(c & ~RISING for c in codes)
    if largest >= SCALE_CODES:
        raise PayloadError(f"a scale code of the weights is {largest}; 0 to {SCALE_CODES - 1} are allowed")
    at = len(sizes) + 4
    state = int.from_bytes(body[at - 4 : at], "little")
    if not LOW <= state < LOW << 8:
        raise PayloadError("the weights start with an impossible state")
    end = len(body)
    mask = (1 << TOTAL_BITS) - 1

    def uniform(bits: int) -> int:
        nonlocal state, at
        value = state & ((1 << bits) - 1)
        state >>= bits
        while state < LOW:
            if at == end:
                raise EndedError("the weights end inside their symbols")
            state = state << 8 | body[at]
            at += 1
        return value

    for size, byte in zip(sizes, codes, strict=True):
        code, rising = byte & ~RISING, byte & RISING
        low, table, starts, lookup = low_bits(code), frequencies(code), _starts(code), _lookup(code)
        values = []
        for _ in range(size):
            bucket = lookup[state & mask]
            state = table[bucket] * (state >> TOTAL_BITS) + (state & mask) - starts[bucket]
            while state < LOW:
                if at == end:
                    raise EndedError("the weights end inside their symbols")
                state = state << 8 | body[at]
                at += 1
            if bucket == ESCAPE:
                magnitude = uniform(8) << 8
                magnitude |= uniform(8)
            else:
                magnitude = bucket << low | uniform(low) if low else bucket
            values.append(-magnitude if magnitude and not rising and uniform(1) else magnitude)
        flat = np.cumsum(values, dtype=np.int64) if rising else np.array(values, dtype=np.int64)
        if np.abs(flat).max() > MAX_SYMBOL:
            raise PayloadError(f"a weight symbol is beyond {MAX_SYMBOL}")
        yield flat.astype(np.int32)
    if state != LOW or at != end:
        raise PayloadError("the weights go on after their last symbol, or are damaged")
