"""Where rays first cross the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I64, Mask
from .cells import CellGrid

RAYS = 2**11  # followed at once: some 40 MB
SAMPLES = 8  # of f on a cell's length of ray: a crossing there and back between two of them is missed
BISECTIONS = 12  # of what lies between two samples: to 2^-22 of the solid's longest side


class RayHits(NamedTuple):
    """What `Model.ray_intersect` finds, in input coordinates and units.

    distance: (...,), inf where a ray misses. point, normal: (..., 3), NaN where it misses; normals are of
    length one and face outward.
    """

    distance: npt.NDArray[np.floating]
    point: npt.NDArray[np.floating]
    normal: npt.NDArray[np.floating]


def first_crossings(cells: CellGrid, origins: F64, directions: F64) -> F64:
    """Distances (N,) at which rays first go into the solid or out of it; inf for those that never do.

    origins, directions: (N, 3) in the normalised frame, directions of length one. A ray
    with a number that is not finite misses.
    """
    out = np.full(len(origins), np.inf)
    enter, leave = _clip(cells, origins, directions)
    rays = np.flatnonzero(enter < leave)
    for at in range(0, len(rays), RAYS):
        part = rays[at : at + RAYS]
        # From the box on, not from the origin: that may be too far away for float32.
        start = (origins[part] + enter[part, None] * directions[part]).astype(np.float32)
        length = leave[part] - enter[part]
        out[part] = enter[part] + _in_box(cells, start, directions[part].astype(np.float32), length)
    return out


def _clip(cells: CellGrid, origins: F64, directions: F64) -> tuple[F64, F64]:
    """Distances at which rays enter and leave the cells' box, from 0 on: enter < leave where they meet it."""
    lo, hi = cells.box
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lo - origins) / directions, (hi - origins) / directions
        # NaN says that a ray runs in a plane of the box, which is no bound on it.
        enter = np.fmax.reduce(np.minimum(a, b), axis=1)
        leave = np.fmin.reduce(np.maximum(a, b), axis=1)
    valid = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1)
    return np.where(valid, np.maximum(enter, 0), np.inf), leave


def _in_box(cells: CellGrid, start: F32, direction: F32, length: F64) -> F64:
    """As `first_crossings`, for rays that start in the box and leave it after `length`."""

    def inside(rays: I64, t: npt.NDArray[np.floating]) -> Mask:
        """Whether rays are inside at distances t (len(rays), k)."""
        points = start[rays, None] + t[..., None].astype(np.float32) * direction[rays, None]
        return cells.contains(points.reshape(-1, 3)).reshape(t.shape)

    # Rays are cut into segments as long as a cell's edge. All of a segment is in its middle's cell or one next to
    # it, so that f has one sign on it where none of these is near the surface.
    edge = np.float32(cells.edge)
    counts = np.ceil(length / edge)
    n = np.arange(counts.max(), dtype=np.float32)
    middles = start[:, None] + ((n + np.float32(0.5)) * edge)[:, None] * direction[:, None]
    beside = cells.lookup(middles.reshape(-1, 3), cells.beside).reshape(len(start), len(n))
    ray, segment = np.nonzero((beside > 0) & (n < counts[:, None]))
    everyone = np.arange(len(start))
    at, end = np.searchsorted(ray, everyone), np.searchsorted(ray, everyone, side="right")

    out = np.full(len(start), np.inf)
    before = np.full(len(start), np.nan, np.float32)  # where rays that cross were last seen on their first side
    side = inside(everyone, np.zeros((len(start), 1), np.float32))[:, 0]
    steps = np.arange(1, SAMPLES + 1, dtype=np.float32) / SAMPLES
    rays = everyone[at < end]
    while len(rays):
        first = segment[at[rays]].astype(np.float32)[:, None]
        crossed = inside(rays, (first + steps) * edge) != side[rays, None]
        hit = crossed.any(axis=1)
        before[rays[hit]] = (first[hit, 0] + crossed[hit].argmax(axis=1) / np.float32(SAMPLES)) * edge
        rays = rays[~hit]
        at[rays] += 1
        rays = rays[at[rays] < end[rays]]

    rays = np.flatnonzero(~np.isnan(before))
    a, width = before[rays], edge / SAMPLES
    for _ in range(BISECTIONS):
        width /= 2
        a = np.where(inside(rays, (a + width)[:, None])[:, 0] == side[rays], a + width, a)
    out[rays] = a + width / 2
    return out
