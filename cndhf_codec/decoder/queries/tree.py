"""A tree of boxes around triangles: the nearest points and the first hits that it finds.

The queries of a call go down the tree together, as pairs of a query and a node. A query for the nearest point first
goes straight down to one triangle that is likely to be near; its distance prunes what is looked at afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64, Mask
from ...arguments import chunks
from .near import NearTriangles

CHILDREN = 8  # of a node; also the most nodes of the top level
PAIRS_AT_ONCE = 2**15  # of queries and nodes, looked at together


class Level(NamedTuple):
    """Boxes of one level's nodes: least and greatest corners (3, K) and centres (3, K).

    Node i has the nodes CHILDREN * i to CHILDREN * (i + 1) - 1 of the next level as its children. Nodes that fill up a
    group have boxes at infinity.
    """

    lo: F64
    hi: F64
    centre: F64


class BoxTree:
    """The triangles in an order in which neighbours are near each other, and boxes around groups of them."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        corners = np.stack([vertices[:, k][faces.T] for k in range(3)], axis=1)  # by corner and coordinate
        lo, hi = corners.min(axis=0), corners.max(axis=0)
        self.order = _order((lo + hi) / 2)
        self._near = NearTriangles(corners[:, :, self.order])
        levels = [_level(lo[:, self.order], hi[:, self.order])]
        while levels[-1].lo.shape[1] > CHILDREN:
            lo, hi = (x.reshape(3, -1, CHILDREN) for x in levels[-1][:2])
            levels.append(_level(lo.min(axis=2), hi.max(axis=2)))
        self._levels = levels[::-1]

    def nearest(self, points: F64) -> tuple[I64, F64]:
        """Faces (N,) that are nearest to points (N, 3), all finite, and their nearest points (N, 3)."""
        x = np.ascontiguousarray(points.T)
        found = self._guess(x)
        squared, foot = self._near.feet(found, x)
        self.pairs = [0] * (len(self._levels)+1)
        self.visits = 0
        def near(depth: int, query: I64, node: I64) -> Mask:
            self.pairs[depth] += len(query)
            lo, hi, _ = self._levels[depth]
            total = np.zeros(len(query))
            for k in range(3):
                at = x[k].take(query)
                outside = np.maximum(lo[k].take(node) - at, at - hi[k].take(node))
                np.maximum(outside, 0, out=outside)
                outside *= outside
                total += outside
            return total < squared.take(query)

        def test(query: I64, triangle: I64) -> None:
            self.pairs[-1] += len(query)
            # In the order of queries: the least of each is that of a range.
            feet = self._near.feet(triangle, x.take(query, axis=1))
            first = np.flatnonzero(np.diff(query, prepend=-1))
            least = np.minimum.reduceat(feet.squared, first)
            at = np.flatnonzero(feet.squared == np.repeat(least, np.diff(first, append=len(query))))
            at = at[feet.squared.take(at) < squared.take(query.take(at))]
            at = at[np.diff(query.take(at), prepend=-1) > 0]
            found[query[at]], squared[query[at]], foot[:, query[at]] = triangle[at], feet.squared[at], feet.point[:, at]

        self._descend(len(points), near, test)
        return self.order.take(found), np.ascontiguousarray(foot.T)

    def _guess(self, x: F64) -> I64:
        """A triangle near each point x (3, N): down the tree, always to the child with the nearest centre."""
        node = np.zeros(x.shape[1], np.int64)
        for level in self._levels:
            least = np.full(x.shape[1], np.inf)
            child = np.zeros(x.shape[1], np.int64)
            for i in range(CHILDREN):
                at = node + i
                squared = np.zeros(x.shape[1])
                for k in range(3):
                    off = level.centre[k].take(at)
                    off -= x[k]
                    off *= off
                    squared += off
                nearer = squared < least
                np.copyto(least, squared, where=nearer)
                np.copyto(child, at, where=nearer)
            node = child * CHILDREN
        return child

    def _descend(
        self, queries: int, keep: Callable[[int, I64, I64], Mask], test: Callable[[I64, I64], None]
    ) -> None:
        """Call test(query, triangle) for the pairs whose nodes, on all levels, `keep(depth, query, node)` keeps.

        Pairs are tested soon after they are found, so that what a test finds can serve `keep`; in the order of queries.
        """
        offsets = np.arange(CHILDREN)

        def below(depth: int, query: I64, node: I64) -> None:
            for first, last in chunks(len(query), PAIRS_AT_ONCE // CHILDREN):
                q = np.repeat(query[first:last], CHILDREN)
                child = (node[first:last, None] * CHILDREN + offsets).ravel()
                at = np.flatnonzero(keep(depth, q, child))
                if not len(at):
                    continue
                q, child = q.take(at), child.take(at)
                if depth + 1 == len(self._levels):
                    test(q, child)
                else:
                    below(depth + 1, q, child)

        everything = np.arange(queries)
        below(0, everything, np.zeros(queries, np.int64))


def _level(lo: F64, hi: F64) -> Level:
    """A level of nodes with these boxes, filled up to whole groups."""
    fill = (0, -lo.shape[1] % CHILDREN)
    lo = np.pad(lo, ((0, 0), fill), constant_values=np.inf)
    hi = np.pad(hi, ((0, 0), fill), constant_values=-np.inf)
    return Level(lo, hi, np.where(lo <= hi, (lo + np.where(lo <= hi, hi, lo)) / 2, np.inf))


def _order(x: F64) -> I64:
    """An order of points (3, N) in which all that will share a node are near each other.

    All points are halved across the longest side of their box, the halves again, and so on.
    """
    n = x.shape[1]
    order = np.arange(n)
    size = 1
    while size < n:
        size *= 2
    while size > 1:
        first = np.arange(0, n, size)
        lo, hi = np.minimum.reduceat(x, first, axis=1), np.maximum.reduceat(x, first, axis=1)
        axis = (hi - lo).argmax(axis=0)
        block = np.arange(n) // size
        each = np.arange(len(first))
        origin, side = lo[axis, each], (hi - lo)[axis, each]
        part = (x[axis.take(block), np.arange(n)] - origin.take(block)) / np.where(side > 0, side, 1).take(block)
        moved = np.argsort(block + part / 2, kind="stable")
        x, order = x.take(moved, axis=1), order.take(moved)
        size //= 2
    return order
