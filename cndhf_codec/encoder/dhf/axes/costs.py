"""Choose sets of axes by the error that the intersection of their exact height fields leaves.

The cost of an axis at a surface point is the error that a height field along it leaves there. Where the axis does not
see the point, it is the length filled in front of the point. Where it does, it is a little that grows with the slant. A
set costs at each point what its best axis costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ....arrays import F64, Mask
from ....errors import require
from ....mesh.sampling import fibonacci_sphere
from ....mesh.solid import Solid
from ...thread_pool import ThreadPool
from .mirrors import MirrorPlane

# Evidence for these constants: ADR 004; DIRECTIONS_IN_PLANE: 006.
DIRECTIONS = 200  # on the whole sphere; an axis and its opposite are the same, so half of them are used
N_ALIGNED = 6  # the last of the candidates: coordinate and principal axes
DIRECTIONS_IN_PLANE = 16  # in a mirror plane
SURFACE_POINTS = 20_000
SLANT_COST = 2e-4  # of a point that is seen at a cosine of 1/2 (normalised units)
LEAST_COSINE = 0.1
IN_FRONT = 1e-3  # distance in front of a hidden point at which the solid is looked for (normalised units)


class AxisCosts:
    """Costs of all candidate axes at samples of the surface. planes: the solid's mirror planes."""

    def __init__(self, solid: Solid, seed: int, threads: ThreadPool, planes: Sequence[MirrorPlane] = ()) -> None:
        points, normals = solid.sample(SURFACE_POINTS, np.random.default_rng(seed))
        free, mirrored = _candidates(solid), _within(planes)
        self.axes = np.concatenate([free, mirrored])
        self._aligned = range(len(free) - N_ALIGNED, len(free))
        self._mirrored = range(len(free), len(self.axes))
        rows = threads.map(lambda a: _cost(solid, points, normals, a), list(self.axes))
        self.costs, self._seen, self._depths = (np.stack(part) for part in zip(*rows, strict=True))
        self._points = points
        hidden = np.flatnonzero(~self._seen.any(axis=0))
        # A face with solid on both sides (of parts that overlap or lie in others) bounds nothing, and is not missed.
        bounds = ~solid.contains(points[hidden] + IN_FRONT * normals[hidden])
        self.visible = 1 - float(bounds.sum()) / len(points) if len(hidden) < len(points) else 0.0

    def sets(self, count: int) -> list[list[int]]:
        """Propose sets of `count` axes: the one of least mean cost, the one that includes the best aligned axis, and
        the one of axes within and across mirror planes.

        Along the edges of a mechanical part heights are constant, and walls are silhouettes: networks learn these much
        faster than the heights along slanted axes. Along an axis within a mirror plane, they learn one half only.
        """
        aligned = min(self._aligned, key=lambda k: self.mean_cost([k]))
        sets = [self.best(count), self.best(count, [aligned])]
        if len(self._mirrored) >= count:
            sets.append(self.best(count, among=self._mirrored))
        return [s for k, s in enumerate(sets) if sorted(s) not in map(sorted, sets[:k])]

    def best(self, count: int, given: Sequence[int] = (), among: Sequence[int] | None = None) -> list[int]:
        """Choose `count` axes of least mean cost, some of them given, the rest from `among` (by default all). It is a
        greedy choice, then single exchanges until none helps. The axis with the largest share comes first."""
        pool = np.arange(len(self.axes)) if among is None else np.array(among)
        chosen = list(given)
        while len(chosen) < count:
            chosen.append(int(pool[np.argmin(self._with(chosen)[pool])]))
        while True:
            before = self.mean_cost(chosen)
            for k in range(len(given), count):
                others = chosen[:k] + chosen[k + 1 :]
                chosen[k] = int(pool[np.argmin(self._with(others)[pool])])
            if not self.mean_cost(chosen) < before * 0.999:  # stops at a cost of 0, too
                return self._ordered(chosen)

    def mean_cost(self, chosen: list[int]) -> float:
        return float(self.costs[chosen].min(axis=0).mean())

    def error_lower_bound(self, chosen: list[int]) -> float:
        """Estimate the mean error that the exact height fields leave. Only one of the two directed distances in it sees
        what they fill."""
        costs, seen = self.costs[chosen], self._seen[chosen]
        best = costs.argmin(axis=0), np.arange(costs.shape[1])
        return float(np.where(seen[best], 0, costs[best]).mean()) / 2

    def depth(self, chosen: list[int]) -> float:
        """Measure the mean distance of the surface from that of the exact height fields' intersection.

        A point that no axis sees lies within solid. Its depth is the least along the axes, or its distance from the
        nearest point that they see, if that is less.
        """
        seen = self._seen[chosen].any(axis=0)
        if not 0 < seen.sum() < seen.size:
            return 0.0
        tree = require("scipy.spatial", "encode").cKDTree(self._points[seen])
        depth = np.minimum(tree.query(self._points[~seen])[0], self._depths[chosen].min(axis=0)[~seen])
        return float(depth.sum() / seen.size)

    def covered(self, chosen: list[int]) -> float:
        """Share of the surface that at least one of the axes sees."""
        return float(self._seen[chosen].any(axis=0).mean())

    def shares(self, chosen: list[int]) -> F64:
        """(count,) share of the surface for which each axis is the best."""
        return np.bincount(self.costs[chosen].argmin(axis=0), minlength=len(chosen)) / self.costs.shape[1]

    def _with(self, chosen: list[int]) -> F64:
        """Mean cost of the set with each candidate added, (candidates,)."""
        if not chosen:
            return self.costs.mean(axis=1)
        return np.minimum(self.costs, self.costs[chosen].min(axis=0)).mean(axis=1)

    def _ordered(self, chosen: list[int]) -> list[int]:
        shares = self.shares(chosen)
        return [chosen[k] for k in np.argsort(-shares, kind="stable")]


def _candidates(solid: Solid) -> F64:
    sphere = fibonacci_sphere(DIRECTIONS)
    covariance = np.cov(solid.vertices.T)
    return np.concatenate([sphere[: DIRECTIONS // 2], np.eye(3), np.linalg.eigh(covariance)[1].T])


def _within(planes: Sequence[MirrorPlane]) -> F64:
    """List axes (N, 3) across the planes, all around within them, and along the lines where two planes meet."""
    axes = [np.empty((0, 3))]
    angles = np.arange(DIRECTIONS_IN_PLANE) * (np.pi / DIRECTIONS_IN_PLANE)
    for plane in planes:
        u = np.cross(plane.normal, np.eye(3)[np.argmin(np.abs(plane.normal))])
        u /= np.linalg.norm(u)
        v = np.cross(plane.normal, u)
        axes += [plane.normal[None], np.outer(np.cos(angles), u) + np.outer(np.sin(angles), v)]
    axes += [np.cross(a.normal, b.normal)[None] for a, b in combinations(planes, 2)]
    return np.concatenate(axes)


def _cost(solid: Solid, points: F64, normals: F64, axis: F64) -> tuple[F64, Mask, F64]:
    """Measure, at each point, the cost of the axis (N,), whether the axis sees the point (N,), and, where it does not,
    how deep in the filled solid the point is along the axis (N,)."""
    seen = solid.visible_along(axis, points, normals)
    cosine = np.clip(np.abs(normals @ axis), LEAST_COSINE, 1)
    cost = SLANT_COST * (1 / cosine - 1)
    hidden = np.flatnonzero(~seen)
    # What is hidden from the axis is filled up to the nearer of the two surfaces along it.
    p = points[hidden]
    fill = np.full(len(hidden), np.inf)
    for direction in (axis, -axis):
        face = solid.first_hits(p + 3 * direction, -direction)
        n = solid.normals[face]
        corner = solid.vertices[solid.faces[face, 0]]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((corner - p) * n).sum(axis=1) / (n @ direction)
        np.minimum(fill, np.where((face >= 0) & np.isfinite(t) & (t >= 0), t, np.inf), out=fill)
    # Along the normal, the way to the surface is no longer than along the axis.
    cost[hidden] = np.where(np.isfinite(fill), fill * np.maximum(cosine[hidden], 0.3), 0)
    depth = np.zeros(len(points))
    depth[hidden] = fill
    return cost, seen, depth
