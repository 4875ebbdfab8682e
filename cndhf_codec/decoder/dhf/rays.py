"""Where rays first cross the surface.

A ray is sampled only where it passes cells next to the surface; the first change of side is bisected.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I64, Mask
from .cells import CellGrid

RAYS_AT_ONCE = 2**11  # about 40 MB
# Evidence for these constants: ADR 031.
SAMPLES_PER_CELL = 8  # a ray that goes in and out again between two samples misses both crossings
BISECTIONS = 12  # of the ray between two samples: to 2^-22 of the solid's longest side


def first_crossings(cells: CellGrid, origins: F64, directions: F64) -> F64:
    """Distances (N,) at which rays first enter or leave the solid; inf for those that never do.

    origins, directions: (N, 3) in the normalised frame, directions of length one. A ray with a number that is not
    finite misses.
    """
    out = np.full(len(origins), np.inf)
    enter, leave = _clip(cells, origins, directions)
    rays = np.flatnonzero(enter < leave)
    for at in range(0, len(rays), RAYS_AT_ONCE):
        part = rays[at : at + RAYS_AT_ONCE]
        # Start at the box: the origin may be too distant for float32.
        start = (origins[part] + enter[part, None] * directions[part]).astype(np.float32)
        length = leave[part] - enter[part]
        out[part] = enter[part] + _in_box(cells, start, directions[part].astype(np.float32), length)
    return out


def _clip(cells: CellGrid, origins: F64, directions: F64) -> tuple[F64, F64]:
    """Distances (N,), at least 0, at which rays enter and leave the cells' box: enter < leave where they meet it."""
    lo, hi = cells.box
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (lo - origins) / directions, (hi - origins) / directions
        # NaN: the ray lies in a plane of the box, which does not bound it.
        enter = np.fmax.reduce(np.minimum(a, b), axis=1)
        leave = np.fmin.reduce(np.maximum(a, b), axis=1)
    valid = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1)
    return np.where(valid, np.maximum(enter, 0), np.inf), leave


def _in_box(cells: CellGrid, start: F32, direction: F32, length: F64) -> F64:
    """As `first_crossings`, for rays that start in the cells' box and leave it after `length` (N,)."""

    def inside(rays: I64, t: npt.NDArray[np.floating]) -> Mask:
        """Whether points of rays (n,) at distances t (n, k) are inside the solid, (n, k)."""
        points = start[rays, None] + t[..., None].astype(np.float32) * direction[rays, None]
        return cells.contains(points.reshape(-1, 3)).reshape(t.shape)

    # Rays are cut into segments as long as a cell's edge. A segment lies in its middle's cell and those that touch it,
    # so the ray cannot cross the surface where none of these holds any of it.
    edge = np.float32(cells.edge)
    counts = np.ceil(length / edge)
    n = np.arange(counts.max(), dtype=np.float32)
    middles = start[:, None] + ((n + np.float32(0.5)) * edge)[:, None] * direction[:, None]
    candidate = cells.lookup(middles.reshape(-1, 3), cells.around_surface).reshape(len(start), len(n))
    ray, segment = np.nonzero((candidate > 0) & (n < counts[:, None]))
    all_rays = np.arange(len(start))
    at, end = np.searchsorted(ray, all_rays), np.searchsorted(ray, all_rays, side="right")

    out = np.full(len(start), np.inf)
    before = np.full(len(start), np.nan, np.float32)  # the last sample before the crossing
    side = inside(all_rays, np.zeros((len(start), 1), np.float32))[:, 0]
    steps = np.arange(1, SAMPLES_PER_CELL + 1, dtype=np.float32) / SAMPLES_PER_CELL
    rays = all_rays[at < end]
    while len(rays):
        first = segment[at[rays]].astype(np.float32)[:, None]
        crossed = inside(rays, (first + steps) * edge) != side[rays, None]
        hit = crossed.any(axis=1)
        before[rays[hit]] = (first[hit, 0] + crossed[hit].argmax(axis=1) / np.float32(SAMPLES_PER_CELL)) * edge
        rays = rays[~hit]
        at[rays] += 1
        rays = rays[at[rays] < end[rays]]

    rays = np.flatnonzero(~np.isnan(before))
    a, width = before[rays], edge / SAMPLES_PER_CELL
    for _ in range(BISECTIONS):
        width /= 2
        a = np.where(inside(rays, (a + width)[:, None])[:, 0] == side[rays], a + width, a)
    out[rays] = a + width / 2
    return out
