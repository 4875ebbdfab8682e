"""The isosurface f = 0 by marching cubes in a narrow band, and occupancy grids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, Mask
from ...errors import SurfaceError
from ..limits import Limits
from ..parallel import over_rows
from ..results import OccupancyGrid, TriangleMesh
from .band import NODE_OFFSETS, NODES_PER_BRICK, Band, Grid, narrow_band
from .field import Dhf, implicit, implicit_gradient
from .marching_cubes import Edges, crossed_edges, faces_between, neighbour_bricks
from .steep_nodes import refine_steep_nodes
from .table import HeightTable

# Evidence for these constants: ADR 028.
#
# In spacings of the grid:
NODE_CLEARANCE = 1e-3  # the least distance of a vertex from a node
LAST_STEP_BELOW = 0.05  # a vertex with |f| below this takes one more step, and is done

SECANT_STEPS = 5  # of root finding along a vertex's edge, at most
NEWTON_STEPS = 2  # for vertices without a crossing on their edge
POINTS_AT_ONCE = 2**17


class GridTables(NamedTuple):
    """A grid around the solid and a height table per DHF, about as fine as the grid."""

    grid: Grid
    tables: list[HeightTable]


def make_grid(dhfs: Sequence[Dhf], resolution: int) -> GridTables:
    """Make a grid with `resolution` cells along the solid's longest side, and its height tables.

    Raises SurfaceError when the solid is empty.
    """
    margin = 4.0 / resolution  # first guess of the spacing: as if the solid filled the largest possible box
    lo, hi = _solid_bounds(dhfs, [HeightTable(d, margin) for d in dhfs], margin)
    # `resolution` cells span the solid without its margins; a solid smaller than these is taken as a tenth of the box.
    # Half a cell less, so that no node falls on the planes that bound the solid, where rounding decides the sign of f.
    size = float((hi - lo).max())
    spacing = max(size - 2 * margin, size / 10) / (resolution - 0.5)
    # Tables as fine as the grid, but with at most 2 * resolution + 1 nodes along a side. Only a solid much smaller than
    # its domain comes to that bound, without which it could ask for gigabytes.
    tables = [HeightTable(d, max(spacing, float(np.ptp(d.bounds[:2], axis=1).max()) / (2 * resolution))) for d in dhfs]
    lo, hi = _solid_bounds(dhfs, tables, spacing)
    shape = np.ceil((hi - lo) / spacing).astype(int) + 3
    origin = (lo + hi) / 2 - (shape - 1) / 2 * spacing
    return GridTables(Grid(origin, spacing, (int(shape[0]), int(shape[1]), int(shape[2]))), tables)


def isosurface(dhfs: Sequence[Dhf], grid_tables: GridTables, limits: Limits) -> TriangleMesh:
    """The surface f = 0, closed and facing outward. Time and memory grow with its area, not with the grid's volume.

    Raises SurfaceError when no node is inside, or the surface has too many vertices.
    """
    grid, tables = grid_tables
    band = narrow_band(grid, dhfs, tables)
    neighbours = neighbour_bricks(band)
    edges = crossed_edges(band, neighbours)
    if refine_steep_nodes(band, dhfs, edges.ends):
        edges = crossed_edges(band, neighbours)
    limits.count("vertices", len(edges.ends))
    if not len(edges.ends):
        raise SurfaceError("the solid is empty or thinner than a voxel; raise the resolution")
    faces = faces_between(band, edges)
    vertices, found = _crossings(band, dhfs, edges)
    missed = np.flatnonzero(~found)
    vertices[missed] = _onto_surface(dhfs, vertices[missed].astype(np.float32), grid.spacing)
    return TriangleMesh(vertices, faces)


def occupancy(dhfs: Sequence[Dhf], grid_tables: GridTables, limits: Limits) -> OccupancyGrid:
    """f >= 0 at the nodes of the grid, in the normalised frame. Raises SurfaceError for too many nodes."""
    grid, tables = grid_tables
    limits.count("nodes", math.prod(grid.shape))
    out = narrow_band(grid, dhfs, tables).dense()
    # Tables are not exact where heights bend, so the networks decide about nodes next to the surface.
    at = np.argwhere(_next_to_surface(out))
    for start in range(0, len(at), POINTS_AT_ONCE):
        part = at[start : start + POINTS_AT_ONCE]
        points = (grid.origin + grid.spacing * part).astype(np.float32)
        out[tuple(part.T)] = implicit(dhfs, points) >= 0
    return OccupancyGrid(out, grid.origin, grid.spacing)


def _next_to_surface(inside: Mask) -> Mask:
    """Which nodes have one of their six neighbours on the other side of the surface."""
    out = np.zeros_like(inside)
    for axis in range(3):
        ahead, behind = np.moveaxis(inside, axis, 0)[1:], np.moveaxis(inside, axis, 0)[:-1]
        for rows in (np.moveaxis(out, axis, 0)[1:], np.moveaxis(out, axis, 0)[:-1]):
            rows |= ahead != behind
    return out


def _crossings(band: Band, dhfs: Sequence[Dhf], edges: Edges) -> tuple[F64, Mask]:
    """Where the exact f crosses zero on grid edges, (N, 3) in the normalised frame, and whether it was found, (N,).

    It is not where heights are steep and the tables have the crossing on an edge next to the right one.

    Plain marching cubes takes f as linear along an edge, which it is not across creases and silhouettes: at resolution
    256 that would be the largest error of the surface. So the crossing is found by secant steps with the exact f, kept
    in a bracket (the Illinois method). The slope of a secant takes a third of the time of the analytic one.
    """
    grid, ends, axis = band.grid, edges.ends, edges.axis
    out = np.empty((len(ends), 3))
    found = np.ones(len(ends), dtype=bool)

    def work(first: int, last: int) -> None:
        row, node = np.divmod(ends[first:last, 0], NODES_PER_BRICK)
        nodes = np.empty((3, last - first))
        for k, x in enumerate(nodes):
            np.multiply(band.corners[:, k].take(row) + NODE_OFFSETS[:, k].take(node), grid.spacing, out=x)
            x += grid.origin[k]
        origin, along = nodes.astype(np.float32), axis[first:last]
        fa, fb = band.values.ravel().take(ends[first:last].T)
        owners = band.owners.ravel().take(ends[first:last].T)
        a, b = np.zeros_like(fa), np.ones_like(fa)
        t = fa / (fa - fb)
        left = np.arange(len(t))  # edges that are not done; fa, fb, a, b, kept_a and kept_b are theirs
        # Whether an end of the bracket stayed in the last step. If it stays again, its f is halved (Illinois).
        kept_a, kept_b = np.zeros_like(left, dtype=bool), np.zeros_like(left, dtype=bool)
        for _ in range(SECANT_STEPS):
            points = origin.take(left, axis=1)
            now, direction = t.take(left), along.take(left)
            step = now * np.float32(grid.spacing)
            for k, x in enumerate(points):
                x += (direction == k) * step
            ft = _exact(grid, dhfs, owners.take(left, axis=1), points)
            above = (ft > 0) == (fa > 0)  # the crossing lies between t and b
            fa, fb = np.where(above, ft, fa * (1 - kept_a / 2)), np.where(above, fb * (1 - kept_b / 2), ft)
            a, b = np.where(above, now, a), np.where(above, b, now)
            with np.errstate(invalid="ignore"):
                new = (a * fb - b * fa) / (fb - fa)
            # Not finite where both are 0: table and network disagree about a node where f is nearly 0.
            t[left] = np.where(np.isfinite(new), new, now)
            keep = np.flatnonzero(np.abs(ft) > LAST_STEP_BELOW)
            left = left.take(keep)
            if not len(left):
                break
            fa, fb, a, b, kept_a, kept_b = (x.take(keep) for x in (fa, fb, a, b, ~above, above))
        found[first + left] = False
        step = np.clip(t, NODE_CLEARANCE, 1 - NODE_CLEARANCE) * grid.spacing
        for k, x in enumerate(nodes):
            x += (along == k) * step
        out[first:last] = nodes.T

    over_rows(work, len(ends), POINTS_AT_ONCE)
    return out, found


def _onto_surface(dhfs: Sequence[Dhf], points: F32, spacing: float) -> F32:
    """Move points (N, 3) onto f = 0 by Newton's method along the gradient, by at most a spacing."""
    best, moved = points.copy(), points
    f, gradient = implicit_gradient(dhfs, points)
    least = np.abs(f)
    for step in range(1, NEWTON_STEPS + 1):
        shift = moved - gradient * (f / (gradient**2).sum(axis=1))[:, None] - points
        shift *= np.minimum(1, spacing / np.maximum(np.linalg.norm(shift, axis=1), 1e-12))[:, None]
        moved = points + shift
        if step < NEWTON_STEPS:
            f, gradient = implicit_gradient(dhfs, moved)
        else:
            f = implicit(dhfs, moved)
        better = np.abs(f) < least
        best[better], least[better] = moved[better], np.abs(f[better])
    return best


def _exact(grid: Grid, dhfs: Sequence[Dhf], owners: npt.NDArray[np.uint8], points: F32) -> F32:
    """f (N,) in spacings at points (3, N) on edges, from the networks of the owners (2, N) of the edges' ends."""
    f = np.full(points.shape[1], np.inf, dtype=np.float32)
    for k, dhf in enumerate(dhfs):
        rows = np.flatnonzero((owners[0] == k) | (owners[1] == k))
        f[rows] = np.minimum(f.take(rows), dhf.implicit(points.take(rows, axis=1).T))
    f /= np.float32(grid.spacing)
    return f


def _solid_bounds(dhfs: Sequence[Dhf], tables: Sequence[HeightTable], margin: float) -> tuple[F64, F64]:
    """Lowest and highest corner, in the normalised frame, of a box around the solid, with a margin.

    It is the intersection of the boxes of the DHFs' own solids. Raises SurfaceError when it is empty.
    """
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    for dhf, table in zip(dhfs, tables, strict=True):
        box = table.solid_box(dhf)
        if box[0][0] > box[1][0]:
            raise SurfaceError("the solid is empty at this resolution; raise it")
        lo, hi = np.maximum(lo, box[0] - margin), np.minimum(hi, box[1] + margin)
    if np.any(lo >= hi):
        raise SurfaceError("the solid is empty: its double height fields do not meet")
    return lo, hi
