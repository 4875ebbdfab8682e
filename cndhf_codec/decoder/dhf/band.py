"""The narrow band: f on a regular grid, evaluated only where the surface can be.

The grid is divided into blocks of 16^3 nodes and those into bricks of 4^3. A block that f provably has one sign in and
around is not looked into: its share of the cost is one bound a DHF. So time and memory grow with the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I32, I64, Mask
from ..parallel import over_rows, product
from .field import Dhf
from .table import HeightBounds, HeightTable

BLOCK, BRICK = 16, 4  # nodes along a side
CHILDREN = BLOCK // BRICK
NOBODY = 255  # in `Band.holders`; a file has at most 64 DHFs
OUTSIDE, INSIDE = 0, 1  # rows of values that stand for all bricks without surface

# Field values, in spacings, are kept between these magnitudes. The lower one keeps a surface vertex from
# falling on a grid node, the upper one lets a DHF be left out where it is not near its surface.
LEAST, MOST = 0.01, 4.0
BLOCKS_AT_ONCE, BRICKS_AT_ONCE = 2**17, 5 * 2**10

# The nodes of a brick, (64, 3), last index fastest.
LOCAL = np.indices((BRICK,) * 3, dtype=np.int32).reshape(3, -1).T


@dataclass(frozen=True)
class Grid:
    """Nodes origin + spacing * (i, j, k) of the normalised frame, 0 <= (i, j, k) < shape."""

    origin: F64
    spacing: float
    shape: tuple[int, int, int]


@dataclass(frozen=True)
class Band:
    """The bricks that the surface may pass.

    corners: (n + 2, 3) first node of each brick; rows OUTSIDE and INSIDE belong to none.
    values: (n + 2, 64) f in spacings, clipped; rows OUTSIDE and INSIDE hold a constant.
    holders: (n + 2, 64) number of the DHF whose part of f is the least there, NOBODY where none is near its surface.
    """

    grid: Grid
    corners: I32
    values: F32
    holders: npt.NDArray[np.uint8]
    _blocks: I32  # (nx + 1, ny + 1, nz + 1): row of `_bricks` for a block; beyond the grid all is outside
    _bricks: I32  # (m + 2, 64): row of `values` for a brick of a block

    def rows(self, corners: I32) -> I32:
        """Rows of `values` for the bricks whose first nodes are `corners` (3, ...), 0 <= corner <= shape + 16."""
        x, y, z = corners // BRICK
        bx, by, bz = x // CHILDREN, y // CHILDREN, z // CHILDREN
        child = ((x - CHILDREN * bx) * CHILDREN + y - CHILDREN * by) * CHILDREN + z - CHILDREN * bz
        _, ny, nz = self._blocks.shape
        return self._bricks.take(self._blocks.take((bx * ny + by) * nz + bz) * LOCAL.shape[0] + child)

    def dense(self) -> Mask:
        """Whether f >= 0 at every node of the grid."""
        nx, ny, nz = self.grid.shape
        out = np.empty([-(-n // BRICK) for n in self.grid.shape] + [BRICK] * 3, dtype=bool)
        for i in range(len(out)):
            corners = np.indices((1, *out.shape[1:3]), dtype=np.int32)[:, 0]
            corners[0] = i
            out[i] = (self.values[self.rows(corners * BRICK)] >= 0).reshape(out.shape[1:])
        joined = out.transpose(0, 3, 1, 4, 2, 5).reshape([BRICK * n for n in out.shape[:3]])
        return joined[:nx, :ny, :nz]


def narrow_band(grid: Grid, dhfs: Sequence[Dhf], tables: Sequence[HeightTable]) -> Band:
    """The bricks around f = 0, with f at their nodes, from height tables."""
    n_blocks = [-(-n // BLOCK) for n in grid.shape]
    corners = np.indices(n_blocks, dtype=np.int32).reshape(3, -1).T * BLOCK
    rows, _, chosen = _sift(grid, dhfs, tables, corners, BLOCK)
    blocks = np.full([n + 1 for n in n_blocks], OUTSIDE, dtype=np.int32)
    blocks[:-1, :-1, :-1] = rows.reshape(n_blocks)

    # Coordinates first in memory, as in `np.indices`: numpy is slow along rows of three.
    corners = (corners.T.take(chosen, axis=1)[..., None] + BRICK * LOCAL.T[:, None]).reshape(3, -1).T
    rows, least, chosen = _sift(grid, dhfs, tables, corners, BRICK)
    bricks = np.concatenate([np.full((1, 64), k, np.int32) for k in (OUTSIDE, INSIDE)] + [rows.reshape(-1, 64)])

    corners = np.concatenate([np.zeros((2, 3), np.int32), corners[chosen]])
    least = np.concatenate([np.zeros((*least.shape[:2], 2), bool), least[..., chosen]], axis=2)
    values = np.full((len(corners), LOCAL.shape[0]), MOST, dtype=np.float32)
    values[OUTSIDE] = -MOST
    holders = np.full(values.shape, NOBODY, dtype=np.uint8)
    band = Band(grid, corners, values, holders, blocks, bricks)
    _fill(band, least, dhfs, tables)
    _close(band)
    keep_between(values)
    return band


def keep_between(values: F32) -> None:
    """Keep values of f, in spacings, between LEAST and MOST, in place."""
    np.clip(values, -MOST, MOST, out=values)
    small = np.abs(values) < LEAST
    values[small] = np.where(values[small] >= 0, LEAST, -LEAST)


def _sift(
    grid: Grid, dhfs: Sequence[Dhf], tables: Sequence[HeightTable], corners: I32, side: int
) -> tuple[I32, Mask, I64]:
    """Bounds of f over blocks of side^3 nodes and the nodes next to them.

    Returns for each block OUTSIDE, INSIDE, or 2, 3, ... in turn; (DHFs, 2, N) whether z - near and far - z of a DHF
    may be below MOST there; and which blocks are neither outside nor inside.
    """
    # An edge of the grid that changes sign belongs to two nodes: with a node more on each side, a block that has
    # none is one that no such edge touches.
    half = (side + 1) / 2 * grid.spacing
    centres = grid.origin + grid.spacing * (corners + (side - 1) / 2)
    sizes = [2 * half * np.abs(dhf.rotation[:2]).sum(axis=1) for dhf in dhfs]
    bounds = [HeightBounds(table, size) for table, size in zip(tables, sizes, strict=True)]
    least = np.empty((len(dhfs), 2, len(corners)), dtype=bool)
    lower, upper = (np.full(len(corners), np.inf, dtype=np.float32) for _ in range(2))

    def work(first: int, last: int) -> None:
        for k, dhf in enumerate(dhfs):
            sides, lo, hi = dhf_bounds(dhf, bounds[k], centres[first:last], half)
            least[k, :, first:last] = sides < MOST * grid.spacing
            np.minimum(lower[first:last], lo, out=lower[first:last])
            np.minimum(upper[first:last], hi, out=upper[first:last])

    over_rows(work, len(corners), BLOCKS_AT_ONCE)
    # The grid's border nodes count as outside, whatever f is there.
    inner = np.all((corners >= 2) & (corners + side + 2 <= grid.shape), axis=1)
    rows = np.full(len(corners), OUTSIDE, dtype=np.int32)
    rows[(lower >= 0) & inner] = INSIDE
    chosen = np.flatnonzero((upper >= 0) & ~((lower >= 0) & inner))
    rows[chosen] = np.arange(2, 2 + len(chosen))
    return rows, least, chosen


def dhf_bounds(dhf: Dhf, bounds: HeightBounds, centres: F64, half: float) -> tuple[F32, F32, F32]:
    """Bounds from a DHF's table in cubes of the grid's orientation.

    Lower bounds (2, N) of z - near and far - z, and lower and upper bounds (N,) of f.
    """
    # 1e-5: what float32 may be off by, here and at the nodes.
    reach = (half * np.abs(dhf.rotation).sum(axis=1) + 1e-5).astype(np.float32)[:, None]
    uvz = product(dhf.rotation, centres.T).astype(np.float32)
    lo, hi = uvz - reach, uvz + reach
    heights = bounds(lo[0], lo[1])
    sides = np.stack([lo[2] - heights[2], heights[1] - hi[2]])
    lower = sides.min(axis=0)
    upper = np.minimum(heights[3] - lo[2], hi[2] - heights[0])
    for a, b, (near, far) in zip(lo, hi, dhf.bounds, strict=True):
        np.minimum(lower, np.minimum(a - near, far - b), out=lower)
        np.minimum(upper, np.minimum(b - near, far - a), out=upper)
    return sides, lower, upper


def _fill(band: Band, least: Mask, dhfs: Sequence[Dhf], tables: Sequence[HeightTable]) -> None:
    """Lower the values to the DHFs' f, in spacings; to z - near and far - z where `least` (DHFs, 2, bricks) says so."""
    grid = band.grid
    nodes = (grid.origin + grid.spacing * band.corners).T
    bases = [product(dhf.rotation, nodes).astype(np.float32) for dhf in dhfs]
    offsets = [((LOCAL * grid.spacing) @ dhf.rotation.T).astype(np.float32).T for dhf in dhfs]
    rows = [[np.flatnonzero(side) for side in sides] for sides in least]
    steps = [[table.steps(base[k], k) for k in range(2)] for table, base in zip(tables, bases, strict=True)]

    # In threads there are only operations on long arrays: between shorter ones they wait for the interpreter's lock.
    def work(first: int, last: int) -> None:
        for k, table in enumerate(tables):
            for side in range(2):
                part = rows[k][side][slice(*np.searchsorted(rows[k][side], (first, last)))]
                u, v = ((steps[k][j].take(part)[:, None] + offsets[k][j] / table.step[j]).ravel() for j in range(2))
                height = table.height(side, u, v)
                z = (bases[k][2].take(part)[:, None] + offsets[k][2]).ravel()
                _lower(band, part, k, height - z if side else z - height)

    over_rows(work, len(band.values), BRICKS_AT_ONCE)

    most = MOST * grid.spacing  # a wall of a DHF's box that is farther away does not matter
    for k, (dhf, base, offset) in enumerate(zip(dhfs, bases, offsets, strict=True)):
        lo, hi = (dhf.bounds[:, j, None] for j in range(2))
        beside = base < lo + most - offset.min(axis=1, keepdims=True)
        beside |= base > hi - most - offset.max(axis=1, keepdims=True)
        beside[:, : INSIDE + 1] = False
        part = np.flatnonzero(beside.any(axis=0))
        inner = (base.take(part, axis=1)[..., None] + offset[:, None]).reshape(3, -1)
        _lower(band, part, k, np.minimum(inner - lo, hi - inner).min(axis=0))


def _lower(band: Band, rows: I64, number: int, f: F32) -> None:
    """Lower the values in these rows to the f of the DHF of a number; it holds what it lowers. Overwrites f."""
    f /= np.float32(band.grid.spacing)
    f = f.reshape(-1, len(LOCAL))
    before, held = band.values.take(rows, axis=0), band.holders.take(rows, axis=0)
    # An assignment by mask takes ten times as long: which of two is lower, no processor can predict.
    held += (f < before) * (np.uint8(number) - held)
    band.holders[rows] = held
    band.values[rows] = np.minimum(before, f, out=f)


def _close(band: Band) -> None:
    """Make the grid's outermost nodes and all beyond them empty, so that the surface closes inside the grid."""
    corners, values = band.corners, band.values
    last = np.array(band.grid.shape) - 1
    rows = np.flatnonzero(np.any((corners == 0) | (corners + BRICK > last), axis=1))
    rows = rows[rows > INSIDE]
    nodes = corners[rows, None] + LOCAL
    border = np.any((nodes == 0) | (nodes >= last), axis=-1)
    values[rows] = np.where(border, np.minimum(values[rows], -LEAST), values[rows])
