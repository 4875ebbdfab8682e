"""The boundary surface of a model by marching cubes, slab by slab, and its occupancy grid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..errors import OptionError, SurfaceError, require
from .dhf import Dhf
from .network import F32
from .table import HeightTable

MAX_RESOLUTION = 2048
SLAB_POINTS = 2**22  # grid nodes held at once, unless one plane alone has more

# Field values are scaled by 1 / spacing and kept between these magnitudes. The lower one keeps a surface
# vertex from falling on a grid node (at a cost of at most 0.01 spacings), the two together keep the
# vertices of neighbouring edges distinct in float32.
LEAST, MOST = 0.01, 32.0
CLOSEST = 1e-3  # no vertex comes closer to a node than this (spacings)
REFINEMENTS = 4  # steps of root finding along a vertex's edge
REFINED_AT_ONCE = 2**16


@dataclass(frozen=True)
class Grid:
    """Nodes origin + spacing * (i, j, k) of the normalised frame, 0 <= (i, j, k) < shape."""

    origin: npt.NDArray[np.float64]
    spacing: float
    shape: tuple[int, int, int]


def make_grid(dhfs: Sequence[Dhf], resolution: int) -> tuple[Grid, list[HeightTable]]:
    """A grid around the solid with `resolution` cells along its longest side, and a height table a DHF.

    Raises OptionError for a resolution outside 8 to 2048 and SurfaceError when the model is empty.
    """
    if not 8 <= resolution <= MAX_RESOLUTION:
        raise OptionError(f"resolution is {resolution}; 8 to {MAX_RESOLUTION} are allowed")
    margin = 4.0 / resolution  # first guess of the spacing: as if the solid filled the largest possible box
    lo, hi = _solid_bounds(dhfs, [HeightTable(d, margin) for d in dhfs], margin)
    # Without the margins, so that `resolution` cells span the solid; a solid smaller than them keeps a tenth.
    # Half a cell less, so that no node falls on the planes that bound the solid, where f is zero but for rounding.
    size = float((hi - lo).max())
    spacing = max(size - 2 * margin, size / 10) / (resolution - 0.5)
    # Tables at half the grid's spacing: their own error then stays below that of marching cubes. The bound on
    # their nodes is out of reach of a solid that fills its domain: it keeps a speck from asking for gigabytes.
    tables = [
        HeightTable(d, max(spacing / 2, float(np.ptp(d.bounds[:2], axis=1).max()) / (4 * resolution))) for d in dhfs
    ]
    lo, hi = _solid_bounds(dhfs, tables, spacing)
    shape = np.ceil((hi - lo) / spacing).astype(int) + 3
    origin = (lo + hi) / 2 - (shape - 1) / 2 * spacing
    return Grid(origin, spacing, (int(shape[0]), int(shape[1]), int(shape[2]))), tables


def field_slab(
    grid: Grid, dhfs: Sequence[Dhf], tables: Sequence[HeightTable], first: int, last: int
) -> npt.NDArray[np.float32]:
    """f at the nodes first <= i < last, shape (last - first, ny, nz), in normalised units."""
    axes = [(grid.origin[k] + grid.spacing * np.arange(n)).astype(np.float32) for k, n in enumerate(grid.shape)]
    axes[0] = axes[0][first:last]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    f = np.full(len(points), np.inf, dtype=np.float32)
    for dhf, table in zip(dhfs, tables, strict=True):
        np.minimum(f, dhf.implicit(points, table), out=f)
    return f.reshape(last - first, *grid.shape[1:])


def marching_cubes(dhfs: Sequence[Dhf], resolution: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices (N, 3) float64 in the normalised frame and triangles (M, 3), closed and facing outward.

    Memory is that of the surface plus one slab of the grid. Raises SurfaceError when no node is inside.
    """
    measure = require("skimage.measure", "mesh")
    grid, tables = make_grid(dhfs, resolution)
    vertices: list[npt.NDArray[np.float64]] = []
    faces: list[npt.NDArray[np.int64]] = []
    total, seam = 0, np.empty(0, dtype=np.int64)  # seam: vertices on the plane shared with the next slab
    for first, last in _slabs(grid):
        f = field_slab(grid, dhfs, tables, first, last) / np.float32(grid.spacing)
        f = np.where(f >= 0, np.clip(f, LEAST, MOST), np.clip(f, -MOST, -LEAST))
        _close_border(f, first == 0, last == grid.shape[0])
        if f.max() < 0 or f.min() > 0:
            seam = np.empty(0, dtype=np.int64)
            continue
        v, t, _, _ = measure.marching_cubes(f, level=0.0, gradient_direction="ascent")
        # Vertices on the first plane are those of the last slab's last plane: use its numbers.
        number = np.full(len(v), -1, dtype=np.int64)
        shared = np.flatnonzero(v[:, 0] == 0) if len(seam) else np.empty(0, dtype=np.int64)
        number[shared[np.lexsort(v[shared, 1:].T)]] = seam
        fresh = number < 0
        number[fresh] = total + np.arange(fresh.sum())
        total += int(fresh.sum())
        on_last = np.flatnonzero(v[:, 0] == last - 1 - first)
        seam = number[on_last[np.lexsort(v[on_last, 1:].T)]]
        vertices.append(v[fresh].astype(np.float64) + np.array([first, 0, 0]))
        faces.append(number[t])
    if not faces:
        raise SurfaceError("the solid is empty or thinner than a voxel; raise the resolution")
    nodes = _on_surface(grid, dhfs, np.concatenate(vertices))
    return nodes * grid.spacing + grid.origin, np.concatenate(faces)


def occupancy(dhfs: Sequence[Dhf], resolution: int) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64], float]:
    """Boolean (nx, ny, nz) grid of f >= 0 with the position of its first node and its spacing (normalised)."""
    grid, tables = make_grid(dhfs, resolution)
    out = np.empty(grid.shape, dtype=bool)
    for first, last in _slabs(grid):
        np.greater_equal(field_slab(grid, dhfs, tables, first, last), 0, out=out[first:last])
    # Tables are a little off where heights bend: what lies next to the surface is asked of the networks.
    for first, last in _slabs(grid):
        at = np.argwhere(_beside_surface(out[first:last])) + np.array([first, 0, 0])
        for start in range(0, len(at), REFINED_AT_ONCE):
            part = at[start : start + REFINED_AT_ONCE]
            points = (grid.origin + grid.spacing * part).astype(np.float32)
            out[tuple(part.T)] = implicit(dhfs, points) >= 0
    return out, grid.origin, grid.spacing


def implicit(dhfs: Sequence[Dhf], points: F32) -> F32:
    """f (N,) at points (N, 3) of the normalised frame, from the networks themselves."""
    return np.minimum.reduce([dhf.implicit(points) for dhf in dhfs])


def implicit_gradient(dhfs: Sequence[Dhf], points: F32) -> tuple[F32, F32]:
    """f (N,) and its gradient (N, 3) at points (N, 3) of the normalised frame."""
    f, gradient = dhfs[0].implicit_gradient(points)
    for dhf in dhfs[1:]:
        other, other_gradient = dhf.implicit_gradient(points)
        less = other < f
        f[less], gradient[less] = other[less], other_gradient[less]
    return f, gradient


def _beside_surface(inside: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Nodes one of whose six neighbours is not as they are."""
    out = np.zeros_like(inside)
    for axis in range(3):
        ahead, behind = np.moveaxis(inside, axis, 0)[1:], np.moveaxis(inside, axis, 0)[:-1]
        for rows in (np.moveaxis(out, axis, 0)[1:], np.moveaxis(out, axis, 0)[:-1]):
            rows |= ahead != behind
    return out


def _on_surface(grid: Grid, dhfs: Sequence[Dhf], vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Move each vertex along its grid edge to where the exact f crosses zero; positions in spacings.

    Marching cubes places vertices as if f were linear along an edge, which it is not across creases and
    silhouettes: on a 256 grid that would be the largest error of the surface. Illinois' variant of the
    false position method, which keeps the crossing bracketed.
    """
    axis = np.abs(vertices - np.round(vertices)).argmax(axis=1)
    direction = np.eye(3, dtype=np.float32)[axis]
    start = np.where(direction > 0, np.floor(vertices), np.round(vertices))
    for at in range(0, len(vertices), REFINED_AT_ONCE):
        part = slice(at, at + REFINED_AT_ONCE)
        origin = (grid.origin + grid.spacing * start[part]).astype(np.float32)
        step = direction[part] * np.float32(grid.spacing)

        def f(t: F32, origin: F32 = origin, step: F32 = step) -> F32:
            points = origin + t[:, None] * step
            return implicit(dhfs, points)

        guess = (vertices[part] - start[part])[np.arange(len(origin)), axis[part]].astype(np.float32)
        a, b = np.zeros_like(guess), np.ones_like(guess)
        fa, fb = f(a), f(b)
        crossing = fa * fb < 0  # the height table and the network may disagree about a node next to zero
        t = guess
        for _ in range(REFINEMENTS):
            ft = f(t)
            left = (ft > 0) == (fa > 0)  # the crossing lies between t and b
            fb = np.where(left, fb / 2, ft)
            fa = np.where(left, ft, fa / 2)
            a, b = np.where(left, t, a), np.where(left, b, t)
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.where(crossing & (fa != fb), (a * fb - b * fa) / (fb - fa), guess)
        t = np.clip(t, CLOSEST, 1 - CLOSEST)
        vertices[part] = start[part] + t[:, None] * direction[part]
    return vertices


def _solid_bounds(
    dhfs: Sequence[Dhf], tables: Sequence[HeightTable], margin: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Box of the normalised frame that holds the solid: the intersection of the DHFs' own boxes."""
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    for dhf, table in zip(dhfs, tables, strict=True):
        corners = table.solid_corners(dhf)
        if not len(corners):
            raise SurfaceError("the solid is empty at this resolution; raise it")
        lo = np.maximum(lo, corners.min(axis=0) - margin)
        hi = np.minimum(hi, corners.max(axis=0) + margin)
    if np.any(lo >= hi):
        raise SurfaceError("the solid is empty: its double height fields do not meet")
    return lo, hi


def _slabs(grid: Grid) -> Iterator[tuple[int, int]]:
    """Ranges of planes that share their border plane: (0, a + 1), (a, b + 1), ..."""
    n = grid.shape[0]
    thickness = max(2, SLAB_POINTS // (grid.shape[1] * grid.shape[2]))
    for first in range(0, n - 1, thickness - 1):
        yield first, min(first + thickness, n)


def _close_border(f: npt.NDArray[np.float32], is_first: bool, is_last: bool) -> None:
    """Make the grid's outermost nodes empty, so that the surface closes inside the grid."""
    f[:, [0, -1], :] = np.minimum(f[:, [0, -1], :], -LEAST)
    f[:, :, [0, -1]] = np.minimum(f[:, :, [0, -1]], -LEAST)
    if is_first:
        f[0] = np.minimum(f[0], -LEAST)
    if is_last:
        f[-1] = np.minimum(f[-1], -LEAST)
