"""Positions of control vertices: residuals of predictions from faces that are already placed, on the integer grid.

A vertex w across an edge (x, y) from a placed face (x, y, z) is *foretold* by that face: at

    g + s (g - z),  g = (x + y) / 2

For s = 1 that is the parallelogram of Touma and Gotsman (1998). The faces of a coarse mesh of a curved surface are
bent against each other, and there a smaller s is nearer; on flat parts whose vertices repeat coordinates s = 1 is
exact. So the file says s, in eighths. Where several faces foretell a vertex, the mean is taken.

The next vertex is always one that is foretold by as many faces as any (counted up to 2), and of these the one that
was first to be so. Residuals share one set of contexts: with few hundred vertices, more sets learn too slowly to pay.

Vertices of mechanical parts repeat coordinates: those of one plane share one. Where a file says so, a coordinate is
first compared with those of the corners of the faces that foretell it, the nearest to the prediction first, and is
predicted only when it is none of them.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from ...errors import LimitError, OptionError, PayloadError
from .manifold import Ints
from .models import SignedModel
from .range_coder import Coder, Context

# Evidence for these constants: ADR 035.
MAX_POSITION = 2**18  # of each coordinate, either sign; residuals stay within `SignedModel`'s range
EIGHTHS = 8  # the most that `eighths` may be: s = 1
COUNTED = 2  # faces that foretell a vertex are counted up to here, for the order
# Of coordinates that may be repeated, for the choice of a context: the place of one and their number count up to here.
TRIED, FOUND = 3, 3


class Walk(NamedTuple):
    """The order in which vertices are coded, and what foretells each; it follows from the faces alone.

    order: the vertices. foretold: by vertex, the corners x, y, z of the faces that foretell it. near: by vertex, a
    neighbour that comes before it, of one that no face foretells; -1 for none.
    """

    order: list[int]
    foretold: list[list[tuple[int, int, int]]]
    near: list[int]


def walk_of(faces: Ints) -> Walk:
    """Walk over a mesh (F, 3), as it is decoded."""
    walker = _Walker(faces)
    walker.run()
    return Walk(walker.order, walker.foretold, walker.near)


def code_positions(
    coder: Coder, walk: Walk, eighths: int, repeats: bool = False, positions: Ints | None = None
) -> Ints:
    """Code the positions of all vertices of a mesh, in either direction.

    Parameters
    ----------
    coder : Coder
    walk : Walk
    eighths : int
        8 s, from 0 to 8
    repeats : bool
        whether coordinates are first compared with those of corners nearby
    positions : (V, 3) int array, optional
        grid coordinates; an encoder's only

    Returns
    -------
    (V, 3) int32 array

    Raises
    ------
    LimitError
        if a coordinate to be coded is beyond `MAX_POSITION`
    PayloadError
        if one that is read is
    """
    if not 0 <= eighths <= EIGHTHS:
        raise OptionError(f"field eighths is {eighths}; 0 to {EIGHTHS} are allowed")
    given = None
    if positions is not None:
        if np.abs(positions).max(initial=0) > MAX_POSITION:
            raise LimitError(f"a position of the control mesh is beyond {MAX_POSITION} grid units; take a coarser step")
        given = positions.tolist()
    ahead, back = 8 + eighths, 2 * eighths  # 16 g - ... : (8 + e)(x + y) - 2 e z, over 16
    predicted, other = SignedModel(), SignedModel()
    same = [[[Context() for _ in range(TRIED + 1)] for _ in range(FOUND + 1)] for _ in range(3)]
    at: list[list[int]] = [[]] * len(walk.order)
    here = [0, 0, 0]
    for v in walk.order:
        foretold = walk.foretold[v]
        if foretold:
            model, n = predicted, 16 * len(foretold)
            guess = [n // 2] * 3
            for x, y, z in foretold:
                p, q, r = at[x], at[y], at[z]
                for k in range(3):
                    guess[k] += ahead * (p[k] + q[k]) - back * r[k]
            guess = [total // n for total in guess]
        else:
            model, near = other, walk.near[v]
            guess = here if near < 0 else at[near]
        here = []
        for k in range(3):
            wanted = guess[k] if given is None else given[v][k]
            c = None
            if repeats:
                found = {at[w][k] for corners in foretold for w in corners}
                c = _repeated(coder, same[k], found, guess[k], wanted)
            if c is None:
                c = guess[k] + model.code(coder, 0, wanted - guess[k])
            if not -MAX_POSITION <= c <= MAX_POSITION:
                raise PayloadError(f"vertex {v} of the control mesh lies beyond {MAX_POSITION} grid units")
            here.append(c)
        at[v] = here
    return np.array(at, dtype=np.int32).reshape(-1, 3)


def _repeated(coder: Coder, same: list[list[Context]], found: set[int], guess: int, wanted: int) -> int | None:
    """Code which of the coordinates found nearby is repeated, the nearest to the guess first; None for none of them."""
    contexts = same[min(len(found), FOUND)]
    for i, c in enumerate(sorted(found, key=lambda c: (abs(c - guess), c))):
        if coder.bit(contexts[min(i, TRIED)], int(c == wanted)):
            return c
    return None


def told_of(walk: Walk) -> Ints:
    """(5, K): the vertex, how many faces foretell it, and the corners x, y, z of one of them, for each that does."""
    told = [(v, len(by), *corners) for v, by in enumerate(walk.foretold) for corners in by]
    return np.array(told, dtype=np.int32).reshape(-1, 5).T


def repeated_share(told: Ints, positions: Ints) -> float:
    """The share of coordinates that are equal to one of the corners of the faces that foretell the vertex. told: as
    `told_of` has it."""
    if not told.size:
        return 0.0
    v, _, *corners = told
    same = np.zeros(positions.shape, dtype=bool)
    for w in corners:
        np.logical_or.at(same, v, positions[v] == positions[w])
    return float(same.mean())


def best_eighths(told: Ints, positions: Ints) -> int:
    """The s, in eighths, for which the residuals of a mesh's positions have fewest binary digits in all. told: as
    `told_of` has it."""
    if not told.size:
        return EIGHTHS
    v, n, x, y, z = told
    p = positions.astype(np.float64)
    middle, across = (p[x] + p[y]) / 2 / n[:, None], p[z] / n[:, None]
    g = np.column_stack([np.bincount(v, middle[:, k], len(p)) for k in range(3)])
    d = g - np.column_stack([np.bincount(v, across[:, k], len(p)) for k in range(3)])
    used = np.unique(v)
    digits = [np.log2(1 + np.abs(p - g - e / EIGHTHS * d)[used]).sum() for e in range(EIGHTHS + 1)]
    return int(np.argmin(digits))


class _Walker:
    """The vertices that are placed so far, and which come next."""

    def __init__(self, faces: Ints) -> None:
        self._faces: list[list[int]] = faces.tolist()
        n = 1 + int(faces.max(initial=-1))
        self.order: list[int] = []
        self.foretold: list[list[tuple[int, int, int]]] = [[] for _ in range(n)]
        self.near = [-1] * n
        self._placed = [False] * n
        self._around: list[list[int]] = [[] for _ in range(n)]  # faces of a vertex
        self._sides: dict[tuple[int, int], list[tuple[int, int]]] = {}  # of an edge: face, corner across
        for f, (a, b, c) in enumerate(self._faces):
            for v, x, y in ((a, b, c), (b, c, a), (c, a, b)):
                self._around[v].append(f)
                self._sides.setdefault((x, y) if x < y else (y, x), []).append((f, v))
        self._missing = [3] * len(self._faces)  # corners of a face that are not placed
        self._queues: list[deque[int]] = [deque() for _ in range(COUNTED + 1)]

    def run(self) -> None:
        for first, placed in enumerate(self._placed):
            if not placed:
                self._place(first)
                while (v := self._next()) is not None:
                    self._place(v)

    def _next(self) -> int | None:
        for queue in reversed(self._queues):
            while queue:
                v = queue.popleft()
                # A vertex stands in the queue of each count that it has had; the highest comes first.
                if not self._placed[v]:
                    return v
        return None

    def _place(self, v: int) -> None:
        self._placed[v] = True
        self.order.append(v)
        for f in self._around[v]:
            self._missing[f] -= 1
            a, b, c = self._faces[f]
            if self._missing[f] == 0:
                for x, y, z in ((a, b, c), (b, c, a), (c, a, b)):
                    self._foretell(f, x, y, z)
            else:
                for w in (a, b, c):
                    if not self._placed[w] and self.near[w] < 0:
                        self.near[w] = v
                        self._queues[0].append(w)

    def _foretell(self, face: int, x: int, y: int, z: int) -> None:
        """Let a placed face foretell the vertex across its edge (x, y)."""
        for f, w in self._sides[(x, y) if x < y else (y, x)]:
            if f != face and not self._placed[w]:
                self.foretold[w].append((x, y, z))
                count = len(self.foretold[w])
                if count <= COUNTED:
                    self._queues[count].append(w)
