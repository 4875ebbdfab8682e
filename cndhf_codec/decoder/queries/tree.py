"""A tree of boxes around triangles: the nearest points and the first hits that it finds.

The queries of a call go down the tree together, as pairs of a query and a node. A query for the nearest point first
goes straight down to one triangle that is likely to be near; its distance prunes what is looked at afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...arguments import chunks
from ...arrays import F64, I64
from ..results import NearestPoints, RayHits
from .single import Triangles

CHILDREN = 8  # of a node; also the most nodes of the top level
PAIRS_AT_ONCE = 2**15  # of queries and nodes, looked at together

# Much more than rounding can be off by, in squares, too: in units of the greatest coordinate, and as a factor.
MARGIN, SLACK = 1e-11, 1 + 1e-9
# On the way down to a first triangle, the squared distance of a box's centre counts this much beside that of the box.
# Next to the surface, 1 to 0.05 lead to triangles that are farther off (armadillo: 0.029 to 0.012, against 0.006).
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
        lo, hi, middle = corners.min(axis=0), corners.max(axis=0), corners.mean(axis=0)
        self._box = lo.min(axis=1), hi.max(axis=1)
        self._margin = MARGIN * float(np.abs(self._box).max())
        self._order = _order((lo + hi) / 2)
        self._triangles = Triangles(corners[:, :, self._order])
        nodes = Level(lo[:, self._order], hi[:, self._order], middle[:, self._order])
        self._levels = [_filled(nodes)]
        while nodes.lo.shape[1] > CHILDREN:
            nodes = _parents(nodes)
            self._levels.insert(0, _filled(nodes))

    def nearest(self, points: F64) -> NearestPoints:
        """Nearest points of the triangles to points (N, 3), all finite."""
        x = np.ascontiguousarray(points.T)
        found = self._guess(x)
        # Points that are near each other look at the same nodes: one after the other, they find them in the cache.
        turn = np.argsort(found, kind="stable")
        x, found = x.take(turn, axis=1), found.take(turn)
        squared, foot = self._triangles.feet(found, x)
        bound = squared.copy()  # squares of distances from the surface, and a little more for rounding

        def near(depth: int, query: I64, node: I64) -> I64:
            lo, hi, point = self._levels[depth]
            total = np.zeros(len(query))
            for k in range(3):
                at = x[k].take(query)
                outside = np.maximum(lo[k].take(node) - at, at - hi[k].take(node))
                np.maximum(outside, 0, out=outside)
                outside *= outside
                total += outside
            kept = np.flatnonzero(total < bound.take(query))
            query, node = query.take(kept), node.take(kept)
            reach = np.zeros(len(kept))
            for k in range(3):
                off = x[k].take(query)
                off -= point[k].take(node)
                off *= off
                reach += off
            reach *= SLACK
            reach += self._margin**2
            least = _least_of_each(query, reach, bound)
            bound[query.take(least)] = reach.take(least)
            return kept.compress(total.take(kept) < bound.take(query))

        def test(query: I64, triangle: I64) -> None:
            feet = self._triangles.feet(triangle, x.take(query, axis=1))
            least = _least_of_each(query, feet.squared, squared)
            q = query.take(least)
            found[q], squared[q], foot[:, q] = triangle[least], feet.squared[least], feet.point[:, least]
            bound[q] = np.minimum(bound[q], squared[q])

        self._descend(len(points), near, test)
        back = np.empty_like(turn)
        back[turn] = np.arange(len(turn))
        return NearestPoints(np.sqrt(squared).take(back), self._order.take(found.take(back)), foot.T.take(back, axis=0))

    def first_hits(self, origins: F64, directions: F64) -> RayHits:
        """First hits of rays (N, 3) with directions (N, 3) of length one, all finite."""
        # Rays start where they enter the box around all, so that no rounding is greater than that of the box's numbers.
        lo, hi = self._box[0][:, None] - self._margin, self._box[1][:, None] + self._margin
        d = np.ascontiguousarray(directions.T)
        with np.errstate(divide="ignore", over="ignore"):
            inverse = 1 / d
        enter, leave = _clip(lo - origins.T, hi - origins.T, inverse)
        meets_box = enter <= leave
        enter[~meets_box] = 0
        o = origins.T + enter * d
        frame = _across(d)
        distance = np.where(meets_box, np.inf, -np.inf)  # no node is nearer than -inf
        normal = np.full((3, len(origins)), np.nan)

        def meets(depth: int, query: I64, node: I64) -> I64:
            lo, hi, _ = self._levels[depth]
            at = o.take(query, axis=1)
            nearest, farthest = _clip(
                lo.take(node, axis=1) - self._margin - at,
                hi.take(node, axis=1) + self._margin - at,
                inverse.take(query, axis=1),
            )
            return np.flatnonzero((nearest <= farthest) & (nearest < distance.take(query)))

        def test(query: I64, triangle: I64) -> None:
            hits = self._triangles.hits(
                triangle, o.take(query, axis=1), d.take(query, axis=1), frame.take(query, axis=2)
            )
            least = _least_of_each(query, hits.distance, distance)
            q = query.take(least)
            distance[q], normal[:, q] = hits.distance.take(least), hits.normal.take(least, axis=1)

        self._descend(len(origins), meets, test)
        missed = ~np.isfinite(distance)
        distance = np.where(missed, np.inf, distance + enter)
        point = origins + np.where(missed, np.nan, distance)[:, None] * directions
        return RayHits(distance, point, np.ascontiguousarray(normal.T))

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
                    off = lo + hi
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

    def _descend(self, queries: int, keep: Callable[[int, I64, I64], I64], test: Callable[[I64, I64], None]) -> None:
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


def _least_of_each(query: I64, value: F64, below: F64) -> I64:
    """Places in `value` (n,) of the least of each query, where that is less than below[query]. query: (n,), sorted."""
    if not len(query):
        return query
    first = np.flatnonzero(np.diff(query, prepend=-1))
    least = np.minimum.reduceat(value, first)
    least = np.repeat(np.where(least < below.take(query.take(first)), least, np.nan), np.diff(first, append=len(query)))
    at = np.flatnonzero(value == least)
    return at[np.diff(query.take(at), prepend=-1) > 0]


def _clip(lo: F64, hi: F64, inverse: F64) -> tuple[F64, F64]:
    """Distances (N,), at least 0, at which rays enter and leave boxes: enter <= leave where they meet them.

    lo, hi: (3, N) corners from the rays' origins. inverse: (3, N) inverse of the rays' directions.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        a, b = lo * inverse, hi * inverse
    # NaN: the ray lies in a plane of the box, which does not bound it.
    a, b = np.minimum(a, b), np.maximum(a, b)
    enter = np.fmax(np.fmax(a[0], a[1]), np.fmax(a[2], 0))
    return enter, np.fmin(np.fmin(b[0], b[1]), b[2])


def _across(d: F64) -> F64:
    """Two vectors across each direction, (2, 3, N), that are not near each other; of length one."""
    other = np.zeros_like(d)
    other[np.abs(d).argmin(axis=0), np.arange(d.shape[1])] = 1
    u = np.cross(d, other, axis=0)
    u /= np.sqrt((u**2).sum(axis=0))
    return np.stack([u, np.cross(d, u, axis=0)])


def _parents(nodes: Level) -> Level:
    """The level above: boxes around groups of nodes, and of their points those nearest to the boxes' centres."""
    first = np.arange(0, nodes.lo.shape[1], CHILDREN)
    lo, hi = np.minimum.reduceat(nodes.lo, first, axis=1), np.maximum.reduceat(nodes.hi, first, axis=1)
    points = _filled(nodes).point.reshape(3, -1, CHILDREN)
    nearest = ((points - ((lo + hi) / 2)[:, :, None]) ** 2).sum(axis=0).argmin(axis=1)
    return Level(lo, hi, points[:, np.arange(len(first)), nearest])


def _filled(nodes: Level) -> Level:
    """These nodes, filled up to whole groups."""
    fill = ((0, 0), (0, -nodes.lo.shape[1] % CHILDREN))
    return Level(*(np.pad(x, fill, constant_values=np.inf) for x in nodes))


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
