"""The boundary surface of a model by marching cubes in a narrow band, and its occupancy grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I32, I64, Mask
from ...errors import SurfaceError
from ..limits import Limits
from ..parallel import over_rows
from .band import LOCAL, Band, Grid, narrow_band
from .field import Dhf, implicit, implicit_gradient
from .marching_cubes import bricks_beside, crossed_edges, faces_between
from .steep_nodes import set_walls_right
from .table import HeightTable

CLOSEST = 1e-3  # no vertex comes closer to a node than this (spacings)
CLOSE_ENOUGH = 0.05  # a vertex with |f| below this (spacings) takes one last step
REFINEMENTS = 5  # steps of root finding along a vertex's edge, at most
NEWTON_STEPS = 2  # for vertices without a crossing on their edge
REFINED_AT_ONCE = 2**17


Tabled = tuple[Grid, list[HeightTable]]


def make_grid(dhfs: Sequence[Dhf], resolution: int) -> Tabled:
    """A grid around the solid with `resolution` cells along its longest side, and a height table a DHF.

    Raises SurfaceError when the model is empty.
    """
    margin = 4.0 / resolution  # first guess of the spacing: as if the solid filled the largest possible box
    lo, hi = _solid_bounds(dhfs, [HeightTable(d, margin) for d in dhfs], margin)
    # Without the margins, so that `resolution` cells span the solid; a solid smaller than them keeps a tenth.
    # Half a cell less, so that no node falls on the planes that bound the solid, where f is zero but for rounding.
    size = float((hi - lo).max())
    spacing = max(size - 2 * margin, size / 10) / (resolution - 0.5)
    # Tables as fine as the grid. The bound on their nodes is out of reach of a solid that fills its domain: it keeps
    # a speck from asking for gigabytes.
    tables = [HeightTable(d, max(spacing, float(np.ptp(d.bounds[:2], axis=1).max()) / (2 * resolution))) for d in dhfs]
    lo, hi = _solid_bounds(dhfs, tables, spacing)
    shape = np.ceil((hi - lo) / spacing).astype(int) + 3
    origin = (lo + hi) / 2 - (shape - 1) / 2 * spacing
    return Grid(origin, spacing, (int(shape[0]), int(shape[1]), int(shape[2]))), tables


def marching_cubes(dhfs: Sequence[Dhf], made: Tabled, limits: Limits) -> tuple[F64, I64]:
    """Vertices (N, 3) float64 in the normalised frame and triangles (M, 3), closed and facing outward.

    made: what `make_grid` gives. Time and memory are those of the surface.
    Raises SurfaceError when no node is inside, or the surface has too many vertices.
    """
    grid, tables = made
    band = narrow_band(grid, dhfs, tables)
    beside = bricks_beside(band)
    edges = crossed_edges(band, beside)
    if set_walls_right(band, dhfs, edges.ends):
        edges = crossed_edges(band, beside)
    limits.count("vertices", len(edges.ends))
    if not len(edges.ends):
        raise SurfaceError("the solid is empty or thinner than a voxel; raise the resolution")
    faces = faces_between(band, edges)
    vertices, found = _crossings(band, dhfs, edges.ends, edges.axis)
    missed = np.flatnonzero(~found)
    vertices[missed] = _settled(dhfs, vertices[missed].astype(np.float32), grid.spacing)
    return vertices, faces


def occupancy(dhfs: Sequence[Dhf], made: Tabled, limits: Limits) -> tuple[Mask, F64, float]:
    """Boolean (nx, ny, nz) grid of f >= 0 with the position of its first node and its spacing (normalised).

    made: what `make_grid` gives.
    """
    grid, tables = made
    limits.count("nodes", math.prod(grid.shape))
    out = narrow_band(grid, dhfs, tables).dense()
    # Tables are a little off where heights bend: what lies next to the surface is asked of the networks.
    at = np.argwhere(_beside_surface(out))
    for start in range(0, len(at), REFINED_AT_ONCE):
        part = at[start : start + REFINED_AT_ONCE]
        points = (grid.origin + grid.spacing * part).astype(np.float32)
        out[tuple(part.T)] = implicit(dhfs, points) >= 0
    return out, grid.origin, grid.spacing


def _beside_surface(inside: Mask) -> Mask:
    """Nodes one of whose six neighbours is not as they are."""
    out = np.zeros_like(inside)
    for axis in range(3):
        ahead, behind = np.moveaxis(inside, axis, 0)[1:], np.moveaxis(inside, axis, 0)[:-1]
        for rows in (np.moveaxis(out, axis, 0)[1:], np.moveaxis(out, axis, 0)[:-1]):
            rows |= ahead != behind
    return out


def _crossings(band: Band, dhfs: Sequence[Dhf], ends: I32, axis: I32) -> tuple[F64, Mask]:
    """Where the exact f crosses zero on grid edges, (N, 3) in the normalised frame, and whether a crossing was found.

    ends: (N, 2) nodes of the band; axis: (N,) directions of the edges between them.
    Where heights are steep, the tables may see a crossing on an edge beside that which has it.
    Marching cubes places vertices as if f were linear along an edge, which it is not across creases and
    silhouettes: on a 256 grid that would be the largest error of the surface. Newton's method with the slope of a
    secant, which costs a third of the analytic one, kept in a bracket (the Illinois method).
    """
    grid = band.grid
    out = np.empty((len(ends), 3))
    found = np.ones(len(ends), dtype=bool)

    def work(first: int, last: int) -> None:
        row, node = np.divmod(ends[first:last, 0], len(LOCAL))
        nodes = np.empty((3, last - first))
        for k, x in enumerate(nodes):
            np.multiply(band.corners[:, k].take(row) + LOCAL[:, k].take(node), grid.spacing, out=x)
            x += grid.origin[k]
        origin, along = nodes.astype(np.float32), axis[first:last]
        fa, fb = band.values.ravel().take(ends[first:last].T)
        holders = band.holders.ravel().take(ends[first:last].T)
        a, b = np.zeros_like(fa), np.ones_like(fa)
        t = fa / (fa - fb)
        left = np.arange(len(t))  # those not close enough yet; what follows is theirs
        again_a, again_b = np.zeros_like(left, dtype=bool), np.zeros_like(left, dtype=bool)  # this end stays once more
        for _ in range(REFINEMENTS):
            points = origin.take(left, axis=1)
            now, way = t.take(left), along.take(left)
            step = now * np.float32(grid.spacing)
            for k, x in enumerate(points):
                x += (way == k) * step
            ft = _exact(grid, dhfs, holders.take(left, axis=1), points)
            above = (ft > 0) == (fa > 0)  # the crossing lies between t and b
            fa, fb = np.where(above, ft, fa * (1 - again_a / 2)), np.where(above, fb * (1 - again_b / 2), ft)
            a, b = np.where(above, now, a), np.where(above, b, now)
            with np.errstate(invalid="ignore"):
                new = (a * fb - b * fa) / (fb - fa)
            # Both are zero where the table and the network disagree about a node next to zero.
            t[left] = np.where(np.isfinite(new), new, now)
            keep = np.flatnonzero(np.abs(ft) > CLOSE_ENOUGH)
            left = left.take(keep)
            if not len(left):
                break
            fa, fb, a, b, again_a, again_b = (x.take(keep) for x in (fa, fb, a, b, ~above, above))
        found[first + left] = False
        step = np.clip(t, CLOSEST, 1 - CLOSEST) * grid.spacing
        for k, x in enumerate(nodes):
            x += (along == k) * step
        out[first:last] = nodes.T

    over_rows(work, len(ends), REFINED_AT_ONCE)
    return out, found


def _settled(dhfs: Sequence[Dhf], points: F32, spacing: float) -> F32:
    """Points (N, 3) moved onto f = 0 by Newton's method along its gradient, by at most a spacing."""
    best, moved = points.copy(), points
    f, gradient = implicit_gradient(dhfs, points)
    least = np.abs(f)
    for step in range(1, NEWTON_STEPS + 1):
        way = moved - gradient * (f / (gradient**2).sum(axis=1))[:, None] - points
        way *= np.minimum(1, spacing / np.maximum(np.linalg.norm(way, axis=1), 1e-12))[:, None]
        moved = points + way
        if step < NEWTON_STEPS:
            f, gradient = implicit_gradient(dhfs, moved)
        else:
            f = implicit(dhfs, moved)
        better = np.abs(f) < least
        best[better], least[better] = moved[better], np.abs(f[better])
    return best


def _exact(grid: Grid, dhfs: Sequence[Dhf], holders: npt.NDArray[np.uint8], points: F32) -> F32:
    """f in spacings at points (3, N) of edges, from the networks of the DHFs that hold their ends, (2, N)."""
    f = np.full(points.shape[1], np.inf, dtype=np.float32)
    for k, dhf in enumerate(dhfs):
        rows = np.flatnonzero((holders[0] == k) | (holders[1] == k))
        f[rows] = np.minimum(f.take(rows), dhf.implicit(points.take(rows, axis=1).T))
    f /= np.float32(grid.spacing)
    return f


def _solid_bounds(dhfs: Sequence[Dhf], tables: Sequence[HeightTable], margin: float) -> tuple[F64, F64]:
    """Box of the normalised frame that holds the solid: the intersection of the DHFs' own boxes."""
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    for dhf, table in zip(dhfs, tables, strict=True):
        box = table.solid_box(dhf)
        if box[0][0] > box[1][0]:
            raise SurfaceError("the solid is empty at this resolution; raise it")
        lo, hi = np.maximum(lo, box[0] - margin), np.minimum(hi, box[1] + margin)
    if np.any(lo >= hi):
        raise SurfaceError("the solid is empty: its double height fields do not meet")
    return lo, hi
