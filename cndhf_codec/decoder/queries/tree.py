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

SLACK = 1 + 1e-9  # of bounds that are computed from other numbers than the distances are
# Going down to a first triangle, the squared distance of a box's centre counts this much beside that of the box. 0.3 to
# 0.001 were tried.
BOX_CENTRE_WEIGHT = 0.01


class Level(NamedTuple):
    """Nodes of one level: least and greatest corners of their boxes, and a point of their triangles, (3, K) each.

    Node i has the nodes CHILDREN * i to CHILDREN * (i + 1) - 1 of the next level as its children. Nodes that fill up a
    group are at infinity.
    """

    lo: F64
    hi: F64
    point: F64


class BoxTree:
    """The triangles in an order in which neighbours are near each other, and boxes around groups of them."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        corners = np.stack([vertices[:, k][faces.T] for k in range(3)], axis=1)  # by corner and coordinate
        lo, hi = corners.min(axis=0), corners.max(axis=0)
        self.order = _order((lo + hi) / 2)
        self._near = NearTriangles(corners[:, :, self.order])
        levels = [_level(lo[:, self.order], hi[:, self.order], corners.mean(axis=0)[:, self.order])]
        while levels[-1].lo.shape[1] > CHILDREN:
            lo, hi, points = (x.reshape(3, -1, CHILDREN) for x in levels[-1])
            lo, hi = lo.min(axis=2), hi.max(axis=2)
            # The point that is nearest to the box's centre.
            with np.errstate(invalid="ignore"):
                off = ((points - ((lo + hi) / 2)[:, :, None]) ** 2).sum(axis=0)
            at = np.where(np.isnan(off), np.inf, off).argmin(axis=1)
            levels.append(_level(lo, hi, points[:, np.arange(len(at)), at]))
        self._levels = levels[::-1]

    def nearest(self, points: F64) -> tuple[I64, F64]:
        """Faces (N,) that are nearest to points (N, 3), all finite, and their nearest points (N, 3)."""
        x = np.ascontiguousarray(points.T)
        found = self._guess(x)
        squared, foot = self._near.feet(found, x)
        bound = squared.copy()  # no more than SLACK times the squared distance from some point of the surface
        self.pairs = [0] * (len(self._levels)+1)
        self.surv = [0] * (len(self._levels)+1)

        def near(depth: int, query: I64, node: I64) -> I64:
            self.pairs[depth] += len(query)
            lo, hi, point = self._levels[depth]
            total = np.zeros(len(query))
            for k in range(3):
                at = x[k].take(query)
                outside = np.maximum(lo[k].take(node) - at, at - hi[k].take(node))
                np.maximum(outside, 0, out=outside)
                outside *= outside
                total += outside
            kept = np.flatnonzero(total < bound.take(query))
            if not len(kept):
                return kept
            self.surv[depth] += len(kept)
            q, node = query.take(kept), node.take(kept)
            reach = np.zeros(len(kept))
            for k in range(3):
                off = x[k].take(q)
                off -= point[k].take(node)
                off *= off
                reach += off
            first = np.flatnonzero(np.diff(q, prepend=-1))
            least = np.minimum.reduceat(reach, first)
            least *= SLACK
            of = q.take(first)
            bound[of] = np.minimum(bound.take(of), least)
            return kept.compress(total.take(kept) < bound.take(q))

        def test(query: I64, triangle: I64) -> None:
            self.pairs[-1] += len(query)
            # In the order of queries: the least of each is that of a range.
            feet = self._near.feet(triangle, x.take(query, axis=1))
            first = np.flatnonzero(np.diff(query, prepend=-1))
            least = np.minimum.reduceat(feet.squared, first)
            at = np.flatnonzero(feet.squared == np.repeat(least, np.diff(first, append=len(query))))
            at = at[feet.squared.take(at) < squared.take(query.take(at))]
            at = at[np.diff(query.take(at), prepend=-1) > 0]
            q = query.take(at)
            found[q], squared[q], foot[:, q] = triangle[at], feet.squared[at], feet.point[:, at]
            bound[q] = np.minimum(bound[q], squared[q])

        self._descend(len(points), near, test)
        return self.order.take(found), np.ascontiguousarray(foot.T)

    def _guess(self, x: F64) -> I64:
        """A triangle near each point x (3, N): down the tree, always to the child that seems nearest."""
        node = np.zeros(x.shape[1], np.int64)
        for level in self._levels:
            least = np.full(x.shape[1], np.inf)
            child = node
            for i in range(CHILDREN):
                at = node + i
                score = np.zeros(x.shape[1])
                for k in range(3):
                    lo, hi = level.lo[k].take(at), level.hi[k].take(at)
                    lo -= x[k]
                    hi -= x[k]
                    with np.errstate(invalid="ignore"):
                        off = lo + hi  # NaN, which is never the least, where a group is filled up
                    off *= off
                    off *= BOX_CENTRE_WEIGHT / 4
                    score += off
                    np.negative(hi, out=hi)
                    np.maximum(lo, hi, out=lo)
                    np.maximum(lo, 0, out=lo)
                    lo *= lo
                    score += lo
                nearer = score < least
                np.copyto(least, score, where=nearer)
                child = np.where(nearer, at, child)
            node = child * CHILDREN
        return child

    def _descend(
        self, queries: int, keep: Callable[[int, I64, I64], I64], test: Callable[[I64, I64], None]
    ) -> None:
        """Call test(query, triangle) for the pairs whose nodes, on all levels, `keep(depth, query, node)` keeps.

        Pairs are tested soon after they are found, so that what a test finds can serve `keep`; in the order of queries.
        """
        offsets = np.arange(CHILDREN)

        def below(depth: int, query: I64, node: I64) -> None:
            for first, last in chunks(len(query), PAIRS_AT_ONCE // CHILDREN):
                q = np.repeat(query[first:last], CHILDREN)
                child = (node[first:last, None] * CHILDREN + offsets).ravel()
                at = keep(depth, q, child)
                if not len(at):
                    continue
                q, child = q.take(at), child.take(at)
                if depth + 1 == len(self._levels):
                    test(q, child)
                else:
                    below(depth + 1, q, child)

        everything = np.arange(queries)
        below(0, everything, np.zeros(queries, np.int64))


def _level(lo: F64, hi: F64, point: F64) -> Level:
    """A level of these nodes, filled up to whole groups."""
    fill = ((0, 0), (0, -lo.shape[1] % CHILDREN))
    return Level(*(np.pad(x, fill, constant_values=c) for x, c in ((lo, np.inf), (hi, -np.inf), (point, np.inf))))


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
