"""How many bytes the section of a control mesh takes: the search for a step asks dozens of times per fit.

Connectivity and marks are coded once. Positions are coded as `format.surface.positions` codes them, but compiled, and
only counted: 7 to 10 times as fast as Python writes them. A test holds the two together.

numba keeps compiled code until this file changes. After a change of the constants that it imports, remove its cache.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from ...arrays import I32, I64
from ...format import ControlMesh
from ...format.surface.models import LEARNT, MAX_DIGITS
from ...format.surface.positions import FOUND, TRIED
from ...format.surface.range_coder import BOTTOM, LIMIT, ONE, TOP
from ...format.surface.section import Coding, PositionEncoder

# Contexts of a signed number: whether it is 0, its sign, its digits, and the digits below the first.
NONZERO, NEGATIVE, DIGITS = 0, 1, 2
BELOW = DIGITS + MAX_DIGITS
SIGNED = BELOW + (MAX_DIGITS << LEARNT)
SAME = 2 * SIGNED  # from here on, those of repeated coordinates; before them, both models of residuals


class SectionSizes:
    """Of control meshes that differ in positions and step alone. mesh: one of them."""

    def __init__(self, mesh: ControlMesh) -> None:
        self._encoder = PositionEncoder(mesh)
        walk, told = self._encoder.walk, self._encoder.told.astype(np.int64)
        counts = np.bincount(told[0], minlength=len(walk.order))
        order, near = (np.array(x, dtype=np.int64) for x in (walk.order, walk.near))
        self._walk = order, near, np.append(0, np.cumsum(counts)), told[2:]
        self._found = np.empty(3 * counts.max(), dtype=np.int64)

    def of(self, mesh: ControlMesh) -> Coding:
        """How a mesh is coded, and the bytes of its section."""
        return self._encoder.choose(mesh, self._n_bytes)

    def _n_bytes(self, eighths: int, repeats: bool, positions: I32) -> int:
        state = np.array(self._encoder.start.state, dtype=np.int64)
        contexts = np.repeat(np.array([[ONE // 2], [0]], dtype=np.int64), SAME + 3 * (FOUND + 1) * (TRIED + 1), axis=1)
        _code(state, contexts, self._walk, self._found, eighths, repeats, positions.astype(np.int64))
        low, width, n_bytes = state
        # One byte more unless nothing is left: see `range_coder._shortest`.
        return int(n_bytes) + int(0 < low % TOP <= TOP - width)


@nb.njit(cache=True)
def _code(
    state: I64,
    contexts: I64,
    walk: tuple[I64, I64, I64, I64],
    found: I64,
    eighths: int,
    repeats: bool,
    positions: I64,
) -> None:
    """Code positions (V, 3).

    state: of the range encoder. contexts: (2, N) their chances and counts. walk: order and near, and start and told:
    the faces that foretell vertex v have the corners told[:, i], i from start[v] to start[v + 1]. found: room for a
    coordinate of all corners that foretell one vertex.
    """
    order, near, start, told = walk
    last = -1
    for v in order:
        first, end = start[v], start[v + 1]
        for k in range(3):
            guess, n_found = 0, 0
            if end > first:
                for i in range(first, end):
                    x, y, z = positions[told[0, i], k], positions[told[1, i], k], positions[told[2, i], k]
                    guess += (8 + eighths) * (x + y) - 2 * eighths * z
                guess = (guess + 8 * (end - first)) // (16 * (end - first))
                if repeats:
                    for i in range(first, end):
                        for corner in range(3):
                            n_found = _put(found, n_found, positions[told[corner, i], k], guess)
            elif near[v] >= 0:
                guess = positions[near[v], k]
            elif last >= 0:
                guess = positions[last, k]
            wanted, is_new = positions[v, k], True
            if repeats:
                place = SAME + ((FOUND + 1) * k + min(n_found, FOUND)) * (TRIED + 1)
                for i in range(n_found):
                    is_new = found[i] != wanted
                    _bit(state, contexts, place + min(i, TRIED), not is_new)
                    if not is_new:
                        break
            if is_new:
                _signed(state, contexts, 0 if end > first else SIGNED, wanted - guess)
        last = v


@nb.njit(cache=True)
def _put(found: I64, n: int, c: int, guess: int) -> int:
    """Put a number among n distinct ones, the nearest to a guess first, of two as near the lesser; return their
    number."""
    far, i = abs(c - guess), n
    while i > 0 and (abs(found[i - 1] - guess) > far or (abs(found[i - 1] - guess) == far and found[i - 1] > c)):
        i -= 1
    if i > 0 and found[i - 1] == c:
        return n
    for j in range(n, i, -1):
        found[j] = found[j - 1]
    found[i] = c
    return n + 1


@nb.njit(cache=True)
def _signed(state: I64, contexts: I64, place: int, value: int) -> None:
    _bit(state, contexts, place + NONZERO, value != 0)
    if value == 0:
        return
    _bit(state, contexts, place + NEGATIVE, value < 0)
    value = abs(value)
    target = 0
    while value >> target > 0:
        target += 1
    for digits in range(1, min(target + 1, MAX_DIGITS)):
        _bit(state, contexts, place + DIGITS + digits, digits < target)
    learnt, node = min(target - 1, LEARNT), 1
    for i in range(target - 2, target - 2 - learnt, -1):
        bit = value >> i & 1
        _bit(state, contexts, place + BELOW + ((target - 1) << LEARNT | node), bit == 1)
        node = node << 1 | bit
    for i in range(target - 2 - learnt, -1, -1):
        _split(state, state[1] >> 1, value >> i & 1 == 1)


@nb.njit(cache=True)
def _bit(state: I64, contexts: I64, context: int, bit: bool) -> None:
    zero, count = contexts[0, context], contexts[1, context]
    _split(state, (state[1] >> 16) * zero, bit)
    contexts[0, context] = zero - zero // (count + 2) if bit else zero + (ONE - zero) // (count + 2)
    if count < LIMIT:
        contexts[1, context] = count + 1


@nb.njit(cache=True)
def _split(state: I64, bound: int, bit: bool) -> None:
    if bit:
        state[0] += bound
        state[1] -= bound
    else:
        state[1] = bound
    while state[1] < BOTTOM:
        state[0] = state[0] << 8 & TOP - 1
        state[1] <<= 8
        state[2] += 1
