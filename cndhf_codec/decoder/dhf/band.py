"""The narrow band: f at the nodes of a regular grid, evaluated only where the surface can be.

The grid is divided into blocks of 16^3 nodes, and blocks into bricks of 4^3. Where bounds show that f has one sign in a
block and next to it, the block is not divided: it takes one bound per DHF. So time and memory grow with the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I32, I64, Mask
from ..parallel import matmul, over_rows
from .field import FLOAT32_ERROR, Dhf
from .table import HeightBounds, HeightTable

# Evidence for these constants: ADR 028.
BLOCK_SIDE, BRICK_SIDE = 16, 4  # nodes along a side
BRICKS_PER_SIDE = BLOCK_SIDE // BRICK_SIDE  # of a block
BRICKS_PER_BLOCK = BRICKS_PER_SIDE**3
NODES_PER_BRICK = BRICK_SIDE**3
NO_DHF = 255  # in `Band.owners`; a file has at most 64 DHFs

# Rows of `Band.values`: one for all bricks outside, one for all inside, then one for each brick the surface may pass.
OUTSIDE_ROW, INSIDE_ROW, FIRST_BRICK_ROW = 0, 1, 2

# Magnitudes of f, in spacings, are clipped to this range. The lower end keeps vertices from falling on a grid node; the
# upper end allows a DHF to be left out where its surface is more distant.
MIN_MAGNITUDE, MAX_MAGNITUDE = 0.01, 4.0
BLOCKS_AT_ONCE, BRICKS_AT_ONCE = 2**17, 5 * 2**10

# The nodes of a brick, (64, 3): offsets from its first node, last index fastest. The bricks of a block are in the same
# order, at BRICK_SIDE times these offsets.
NODE_OFFSETS = np.indices((BRICK_SIDE,) * 3, dtype=np.int32).reshape(3, -1).T


@dataclass(frozen=True)
class Grid:
    """Nodes at origin + spacing * (i, j, k) in the normalised frame, 0 <= (i, j, k) < shape."""

    origin: F64
    spacing: float
    shape: tuple[int, int, int]


@dataclass(frozen=True)
class Band:
    """The n bricks that the surface may pass through. Rows OUTSIDE_ROW and INSIDE_ROW stand for all other bricks.

    corners: (n + 2, 3) indices in the grid of the first node of each brick.
    values: (n + 2, 64) f in spacings, clipped.
    owners: (n + 2, 64) number of the DHF whose f is the least there; NO_DHF where all are clipped.
    """

    grid: Grid
    corners: I32
    values: F32
    owners: npt.NDArray[np.uint8]
    _blocks: I32  # (nx + 1, ny + 1, nz + 1): row of `_bricks` for each block; beyond the grid all is outside
    _bricks: I32  # (m + 2, 64): row of `values` for each brick of a block

    def rows(self, corners: I32) -> I32:
        """Rows of `values` (...) for the bricks with first nodes `corners` (3, ...), 0 <= corner <= shape + 16."""
        x, y, z = corners // BRICK_SIDE
        bx, by, bz = x // BRICKS_PER_SIDE, y // BRICKS_PER_SIDE, z // BRICKS_PER_SIDE
        brick = (x - BRICKS_PER_SIDE * bx) * BRICKS_PER_SIDE + y - BRICKS_PER_SIDE * by
        brick = brick * BRICKS_PER_SIDE + z - BRICKS_PER_SIDE * bz
        _, ny, nz = self._blocks.shape
        return self._bricks.take(self._blocks.take((bx * ny + by) * nz + bz) * BRICKS_PER_BLOCK + brick)

    def dense(self) -> Mask:
        """Whether f >= 0 at every node of the grid."""
        nx, ny, nz = self.grid.shape
        out = np.empty([-(-n // BRICK_SIDE) for n in self.grid.shape] + [BRICK_SIDE] * 3, dtype=bool)
        for i in range(len(out)):
            corners = np.indices((1, *out.shape[1:3]), dtype=np.int32)[:, 0]
            corners[0] = i
            out[i] = (self.values[self.rows(corners * BRICK_SIDE)] >= 0).reshape(out.shape[1:])
        joined = out.transpose(0, 3, 1, 4, 2, 5).reshape([BRICK_SIDE * n for n in out.shape[:3]])
        return joined[:nx, :ny, :nz]


def narrow_band(grid: Grid, dhfs: Sequence[Dhf], tables: Sequence[HeightTable]) -> Band:
    """The bricks around f = 0, with f at their nodes from the height tables."""
    n_blocks = [-(-n // BLOCK_SIDE) for n in grid.shape]
    corners = np.indices(n_blocks, dtype=np.int32).reshape(3, -1).T * BLOCK_SIDE
    rows, mixed, _ = _classify(grid, dhfs, tables, corners, BLOCK_SIDE)
    blocks = np.full([n + 1 for n in n_blocks], OUTSIDE_ROW, dtype=np.int32)
    blocks[:-1, :-1, :-1] = rows.reshape(n_blocks)

    # Coordinates first in memory, as in `np.indices`: numpy is slow along rows of three.
    corners = corners.T.take(mixed, axis=1)[..., None] + BRICK_SIDE * NODE_OFFSETS.T[:, None]
    corners = corners.reshape(3, -1).T
    rows, mixed, relevant = _classify(grid, dhfs, tables, corners, BRICK_SIDE)
    no_surface = [np.full((1, BRICKS_PER_BLOCK), row, np.int32) for row in (OUTSIDE_ROW, INSIDE_ROW)]
    bricks = np.concatenate([*no_surface, rows.reshape(-1, BRICKS_PER_BLOCK)])

    corners = np.concatenate([np.zeros((2, 3), np.int32), corners[mixed]])
    relevant = np.concatenate([np.zeros((*relevant.shape[:2], 2), bool), relevant[..., mixed]], axis=2)
    values = np.full((len(corners), NODES_PER_BRICK), MAX_MAGNITUDE, dtype=np.float32)
    values[OUTSIDE_ROW] = -MAX_MAGNITUDE
    owners = np.full(values.shape, NO_DHF, dtype=np.uint8)
    band = Band(grid, corners, values, owners, blocks, bricks)
    _fill(band, relevant, dhfs, tables)
    _clear_border(band)
    clip_magnitude(values)
    return band


def clip_magnitude(values: F32) -> None:
    """Clip magnitudes of f, in spacings, to MIN_MAGNITUDE and MAX_MAGNITUDE, in place; 0 counts as positive."""
    np.clip(values, -MAX_MAGNITUDE, MAX_MAGNITUDE, out=values)
    small = np.abs(values) < MIN_MAGNITUDE
    values[small] = np.where(values[small] >= 0, MIN_MAGNITUDE, -MIN_MAGNITUDE)


class Classified(NamedTuple):
    """Which of N cubes of nodes (blocks or bricks) are outside, inside, or neither.

    rows: (N,) OUTSIDE_ROW, INSIDE_ROW, or FIRST_BRICK_ROW, FIRST_BRICK_ROW + 1, ... in turn. mixed: (M,) numbers of the
    cubes that are neither. relevant: (DHFs, 2, N) whether z - near and far - z of a DHF may be below MAX_MAGNITUDE
    spacings.
    """

    rows: I32
    mixed: I64
    relevant: Mask


def _classify(grid: Grid, dhfs: Sequence[Dhf], tables: Sequence[HeightTable], corners: I32, side: int) -> Classified:
    """Classify cubes of side^3 nodes with first nodes `corners` (N, 3), by bounds of f in them and next to them."""
    # The bounds reach to the nodes next to the cube: so no edge of the grid from a node of a cube that is not mixed
    # changes sign.
    half = (side + 1) / 2 * grid.spacing
    centres = grid.origin + grid.spacing * (corners + (side - 1) / 2)
    sizes = [2 * half * np.abs(dhf.rotation[:2]).sum(axis=1) for dhf in dhfs]
    bounds = [HeightBounds(table, size) for table, size in zip(tables, sizes, strict=True)]
    relevant = np.empty((len(dhfs), 2, len(corners)), dtype=bool)
    lower, upper = (np.full(len(corners), np.inf, dtype=np.float32) for _ in range(2))

    def work(first: int, last: int) -> None:
        for k, dhf in enumerate(dhfs):
            found = dhf_bounds(dhf, bounds[k], centres[first:last], half)
            relevant[k, :, first:last] = found.height_terms < MAX_MAGNITUDE * grid.spacing
            np.minimum(lower[first:last], found.lower, out=lower[first:last])
            np.minimum(upper[first:last], found.upper, out=upper[first:last])

    over_rows(work, len(corners), BLOCKS_AT_ONCE)
    # The grid's border nodes count as outside, whatever f is there.
    inner = np.all((corners >= 2) & (corners + side + 2 <= grid.shape), axis=1)
    rows = np.full(len(corners), OUTSIDE_ROW, dtype=np.int32)
    rows[(lower >= 0) & inner] = INSIDE_ROW
    mixed = np.flatnonzero((upper >= 0) & ~((lower >= 0) & inner))
    rows[mixed] = np.arange(FIRST_BRICK_ROW, FIRST_BRICK_ROW + len(mixed))
    return Classified(rows, mixed, relevant)


class DhfBounds(NamedTuple):
    """Bounds in N cubes of what a DHF's table gives, normalised units.

    height_terms: (2, N) lower bounds of z - near and of far - z. lower, upper: (N,) bounds of f.
    """

    height_terms: F32
    lower: F32
    upper: F32


def dhf_bounds(dhf: Dhf, bounds: HeightBounds, centres: F64, half: float) -> DhfBounds:
    """Bounds in cubes parallel to the grid with these centres (N, 3), `half` from centre to face."""
    reach = (half * np.abs(dhf.rotation).sum(axis=1) + FLOAT32_ERROR).astype(np.float32)[:, None]
    uvz = matmul(dhf.rotation, centres.T).astype(np.float32)
    lo, hi = uvz - reach, uvz + reach
    heights = bounds(lo[0], lo[1])
    height_terms = np.stack([lo[2] - heights[2], heights[1] - hi[2]])
    lower = height_terms.min(axis=0)
    upper = np.minimum(heights[3] - lo[2], hi[2] - heights[0])
    for a, b, (bottom, top) in zip(lo, hi, dhf.bounds, strict=True):
        np.minimum(lower, np.minimum(a - bottom, top - b), out=lower)
        np.minimum(upper, np.minimum(b - bottom, top - a), out=upper)
    return DhfBounds(height_terms, lower, upper)


def _fill(band: Band, relevant: Mask, dhfs: Sequence[Dhf], tables: Sequence[HeightTable]) -> None:
    """Lower the band's values to the DHFs' f.

    relevant: (DHFs, 2, bricks) whether z - near and far - z of a DHF are to be evaluated in a brick.
    """
    grid = band.grid
    nodes = (grid.origin + grid.spacing * band.corners).T
    bases = [matmul(dhf.rotation, nodes).astype(np.float32) for dhf in dhfs]
    offsets = [((NODE_OFFSETS * grid.spacing) @ dhf.rotation.T).astype(np.float32).T for dhf in dhfs]
    rows = [[np.flatnonzero(side) for side in sides] for sides in relevant]
    steps = [[table.steps(base[k], k) for k in range(2)] for table, base in zip(tables, bases, strict=True)]

    # Only operations on long arrays run in threads: between short ones, threads wait for the interpreter's lock.
    def work(first: int, last: int) -> None:
        for k, table in enumerate(tables):
            for side in range(2):
                part = rows[k][side][slice(*np.searchsorted(rows[k][side], (first, last)))]
                u, v = ((steps[k][j].take(part)[:, None] + offsets[k][j] / table.step[j]).ravel() for j in range(2))
                height = table.height(side, u, v)
                z = (bases[k][2].take(part)[:, None] + offsets[k][2]).ravel()
                _lower(band, part, k, height - z if side else z - height)

    over_rows(work, len(band.values), BRICKS_AT_ONCE)

    reach = MAX_MAGNITUDE * grid.spacing  # planes of a domain box that are more distant do not matter
    for k, (dhf, base, offset) in enumerate(zip(dhfs, bases, offsets, strict=True)):
        lo, hi = (dhf.bounds[:, j, None] for j in range(2))
        at_plane = base < lo + reach - offset.min(axis=1, keepdims=True)
        at_plane |= base > hi - reach - offset.max(axis=1, keepdims=True)
        at_plane[:, :FIRST_BRICK_ROW] = False
        part = np.flatnonzero(at_plane.any(axis=0))
        inner = (base.take(part, axis=1)[..., None] + offset[:, None]).reshape(3, -1)
        _lower(band, part, k, np.minimum(inner - lo, hi - inner).min(axis=0))


def _lower(band: Band, rows: I64, number: int, f: F32) -> None:
    """Lower the values in `rows` (N,) to f (64 N,) of DHF `number`, which owns what it lowers. Overwrites f."""
    f /= np.float32(band.grid.spacing)
    f = f.reshape(-1, NODES_PER_BRICK)
    before, owner = band.values.take(rows, axis=0), band.owners.take(rows, axis=0)
    # Arithmetic, because assignment by a mask takes ten times as long: the processor cannot predict which is lower.
    owner += (f < before) * (np.uint8(number) - owner)
    band.owners[rows] = owner
    band.values[rows] = np.minimum(before, f, out=f)


def _clear_border(band: Band) -> None:
    """Put the grid's outermost nodes, and all beyond them, outside, so that the surface closes within the grid."""
    corners, values = band.corners, band.values
    last = np.array(band.grid.shape) - 1
    rows = np.flatnonzero(np.any((corners == 0) | (corners + BRICK_SIDE > last), axis=1))
    rows = rows[rows >= FIRST_BRICK_ROW]
    nodes = corners[rows, None] + NODE_OFFSETS
    border = np.any((nodes == 0) | (nodes >= last), axis=-1)
    values[rows] = np.where(border, np.minimum(values[rows], -MIN_MAGNITUDE), values[rows])
