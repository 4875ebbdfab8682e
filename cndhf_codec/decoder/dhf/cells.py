"""Cells of space: surely inside the solid, surely outside, or undecided, with the networks that decide.

A query looks up the cell of its point, and evaluates networks only in undecided cells, next to the surface. "Surely"
rests on bounds of the heights over patches of each DHF's domain, measured when the cells are made. Where heights are
too rough to be bounded, cells stay undecided: queries are slower there, and still right.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I64, Mask
from ..parallel import matmul
from .field import FLOAT32_ERROR, Dhf

# Evidence for these constants: ADR 031.
CELLS_PER_SIDE = 128  # along the longest side of the solid
COARSE_EDGE = 4  # cells along the edge of a coarse cell, which is looked at first
COARSE_AT_ONCE = 2**11  # coarse cells divided at once: bounds the memory
PATCHES_PER_SIDE = 256  # along the longer side of a DHF's domain

# A smooth function differs from the bilinear interpolation of a patch's corners by at most 1/8 of the sum of its
# greatest second differences along both sides. They are known at nodes only, so they are taken from the neighbouring
# patches too, and multiplied by this. Checked at 4e7 random points of 41 fitted DHFs: 4 with neighbours held at all of
# them, 2 did not, nor did 4 without neighbours.
SECOND_DIFFERENCE_FACTOR = 4.0

BOX_MARGIN = 10 * FLOAT32_ERROR  # of the cells' box around the solid

ADJACENT = np.array([1, 1])  # radius of a window: a patch and its eight neighbours

# A cell's state is a byte. Bit i % STATE_BITS says that DHF i has to be evaluated: several may share a bit.
STATE_BITS = 7
SURELY_INSIDE, SURELY_OUTSIDE = 0, 0xFF
ALL_BITS = 2**STATE_BITS - 1


class CellGrid:
    """The cells of a box around the solid, in the normalised frame."""

    def __init__(self, dhfs: Sequence[Dhf]) -> None:
        self._dhfs = dhfs
        bounds = [PatchBounds(dhf) for dhf in dhfs]
        lo, hi = _common_box(dhfs)
        # The first round finds the solid's box, the second divides it into cells.
        for _ in range(2):
            self.edge = float((hi - lo).max()) / CELLS_PER_SIDE
            n = np.maximum(np.ceil((hi - lo) / (COARSE_EDGE * self.edge)).astype(int), 1)  # coarse cells
            self.origin = (lo + hi) / 2 - n / 2 * (COARSE_EDGE * self.edge)
            coarse = self._states(bounds, _indices(n), COARSE_EDGE, np.full(n.prod(), ALL_BITS, np.uint8)).reshape(n)
            at = np.argwhere(coarse != SURELY_OUTSIDE)
            if not len(at):
                break
            lo, hi = (self.origin + (k * COARSE_EDGE) * self.edge for k in (at.min(axis=0), at.max(axis=0) + 1))
        states = np.empty((*n, COARSE_EDGE, COARSE_EDGE, COARSE_EDGE), np.uint8)
        states[...] = coarse[..., None, None, None]
        mixed = np.argwhere((coarse != SURELY_OUTSIDE) & (coarse != SURELY_INSIDE))
        for part in (mixed[k : k + COARSE_AT_ONCE] for k in range(0, len(mixed), COARSE_AT_ONCE)):
            children = (part[:, None] * COARSE_EDGE + _indices([COARSE_EDGE] * 3)).reshape(-1, 3)
            parents = np.repeat(coarse[tuple(part.T)], COARSE_EDGE**3)
            fine = self._states(bounds, children, 1, parents)
            states[tuple(part.T)] = fine.reshape(-1, *states.shape[3:])
        joined = states.transpose(0, 3, 1, 4, 2, 5).reshape(n * COARSE_EDGE)
        # A border of outside cells: what `lookup` gives for points beyond the box.
        self.shape = n * COARSE_EDGE + 2
        self.states = np.pad(joined, 1, constant_values=SURELY_OUTSIDE).ravel()

    @property
    def box(self) -> tuple[F64, F64]:
        """Least and greatest corner of a box that holds the solid."""
        return self.origin, self.origin + (self.shape - 2) * self.edge

    @cached_property
    def around_surface(self) -> npt.NDArray[np.uint8]:
        """1 for cells that the surface may pass through or that touch such a cell, else 0; for `lookup`."""
        out = ((self.states != SURELY_INSIDE) & (self.states != SURELY_OUTSIDE)).reshape(self.shape)
        for axis in range(3):
            old = out.copy()
            np.moveaxis(out, axis, 0)[1:] |= np.moveaxis(old, axis, 0)[:-1]
            np.moveaxis(out, axis, 0)[:-1] |= np.moveaxis(old, axis, 0)[1:]
        return out.astype(np.uint8).ravel()

    def lookup(self, points: F32, states: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Values (N,) at points (N, 3) of the normalised frame; `states` has a value per cell, with the border."""
        flat = np.zeros(len(points), np.intp)
        for k in range(3):
            with np.errstate(invalid="ignore", over="ignore"):
                g = points[:, k] - np.float32(self.origin[k] - self.edge)
                g /= np.float32(self.edge)
                cell = g.astype(np.int32).view(np.uint32)
            # As unsigned numbers, those below zero or not finite are huge, or 0: the border.
            flat *= self.shape[k]
            flat += np.minimum(cell, np.uint32(self.shape[k] - 1), out=cell)
        return states[flat]

    def contains(self, points: F32) -> Mask:
        """Whether points (N, 3) of the normalised frame are inside, (N,): f >= 0, as from the exact networks."""
        state = self.lookup(points, self.states)
        inside = state == SURELY_INSIDE
        undecided = np.flatnonzero((state != SURELY_OUTSIDE) & ~inside)
        for i, dhf in enumerate(self._dhfs):
            unsure = (state[undecided] >> (i % STATE_BITS)) & 1 > 0
            outside = np.zeros(len(undecided), bool)
            outside[unsure] = ~(dhf.implicit(points[undecided[unsure]]) >= 0)
            undecided = undecided[~outside]
        inside[undecided] = True
        return inside

    def _states(
        self, bounds: Sequence[PatchBounds], cells: I64, edge: int, parents: npt.NDArray[np.uint8]
    ) -> npt.NDArray[np.uint8]:
        """States (N,) of cubes with edges of `edge` cells, at positions `cells` (N, 3) in units of such cubes.

        parents: (N,) states of larger cubes that hold them. A DHF whose bit is not set there decides nothing here.
        """
        half = edge * self.edge / 2 + FLOAT32_ERROR
        centres = (self.origin + (cells + 0.5) * (edge * self.edge)).T
        out = np.zeros(len(cells), np.uint8)
        for i, bound in enumerate(bounds):
            bit = np.uint8(1 << (i % STATE_BITS))
            at = np.flatnonzero((parents & bit > 0) & (out != SURELY_OUTSIDE))
            outside, inside = bound.cubes(centres[:, at], half)
            out[at[~inside]] |= bit
            out[at[outside]] = SURELY_OUTSIDE
        return out


class HeightExtrema(NamedTuple):
    """Bounds of one DHF's heights over patches, each an array with a value per patch."""

    near_least: F32
    near_greatest: F32
    far_least: F32
    far_greatest: F32


class PatchBounds:
    """Least and greatest near and far height of one DHF over each patch of a regular grid on its domain."""

    def __init__(self, dhf: Dhf) -> None:
        self._rotation, self._box = dhf.record.rotation, dhf.bounds.astype(np.float64)
        lo, hi = self._box[:2].T
        self.shape = np.maximum(np.ceil((hi - lo) / (hi - lo).max() * PATCHES_PER_SIDE).astype(int), 1)
        self.lo, self.size = lo, (hi - lo) / self.shape
        # The nodes are the patches' corners, the middles of their sides and their centres.
        u, v = (lo[k] + self.size[k] / 2 * np.arange(2 * self.shape[k] + 1) for k in range(2))
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).astype(np.float32)
        values = dhf.heights(uv.reshape(-1, 2)).reshape(uv.shape)
        least, greatest = _patch_bounds(values, 2)
        # A test of the bounds: those computed from the corners alone must hold at the other nodes. Where they do not,
        # the heights bend more than the nodes show, and neither that patch nor its neighbours have a bound.
        low, high = _patch_bounds(values[::2, ::2], 1)
        smooth = (low <= _over_patches(values, 2, np.minimum)) & (_over_patches(values, 2, np.maximum) <= high)
        rough = _window(~smooth, ADJACENT, np.logical_or).any(axis=-1)
        least[rough], greatest[rough] = -np.inf, np.inf
        self.extrema = HeightExtrema(least[..., 0], greatest[..., 0], least[..., 1], greatest[..., 1])

    def cubes(self, centres: F64, half: float) -> tuple[Mask, Mask]:
        """Which cubes are surely outside, (N,), and which surely inside, (N,).

        centres: (3, N) in the normalised frame. half: half the edge's length.
        """
        uvz = matmul(self._rotation, centres)
        reach = half * np.abs(self._rotation).sum(axis=1)
        patch = [np.clip(((uvz[k] - self.lo[k]) / self.size[k]).astype(int), 0, self.shape[k] - 1) for k in range(2)]
        window = np.ceil(reach[:2] / self.size).astype(int)
        flat = patch[0] * self.shape[1] + patch[1]
        over = HeightExtrema(
            *(
                _window(b, window, extremum).ravel()[flat]
                for b, extremum in zip(self.extrema, (np.minimum, np.maximum) * 2, strict=True)
            )
        )
        low, high = uvz[2] - reach[2], uvz[2] + reach[2]
        outside = (over.far_greatest < over.near_least) | (high < over.near_least) | (low > over.far_greatest)
        inside = (low > over.near_greatest) & (high < over.far_least)
        for x, r, (lo, hi) in zip(uvz, reach, self._box, strict=True):
            outside |= (x + r < lo) | (x - r > hi)
            inside &= (x - r > lo) & (x + r < hi)
        return outside, inside


def _patch_bounds(values: F32, nodes: int) -> tuple[F32, F32]:
    """Heights (n * nodes + 1, m * nodes + 1, 2) at nodes -> least and greatest over n x m patches, each (n, m, 2)."""
    bend = np.zeros_like(values)
    for axis in range(2):
        v, b = np.moveaxis(values, axis, 0), np.moveaxis(bend, axis, 0)
        if len(v) > 2:
            d = np.abs(v[2:] - 2 * v[1:-1] + v[:-2])
            b[1:-1] += d
            b[0] += d[0]
            b[-1] += d[-1]
    margin: F32 = np.float32(SECOND_DIFFERENCE_FACTOR / 8) * _window(
        _over_patches(bend, nodes, np.maximum), ADJACENT, np.maximum
    ) + np.float32(FLOAT32_ERROR)
    return _over_patches(values, nodes, np.minimum) - margin, _over_patches(values, nodes, np.maximum) + margin


def _over_patches(values: F32, nodes: int, extremum: np.ufunc) -> F32:
    """Extremum over the nodes of each patch, including those on its border."""
    for axis in range(2):
        v = np.moveaxis(values, axis, 0)
        n = (len(v) - 1) // nodes
        parts = [v[k : k + (n - 1) * nodes + 1 : nodes] for k in range(nodes + 1)]
        values = np.moveaxis(extremum.reduce(parts), 0, axis)
    return values


def _window(values: npt.NDArray[Any], radius: I64, extremum: np.ufunc) -> npt.NDArray[Any]:
    """Extremum over the window of (2 r + 1) x (2 s + 1) patches around each, (r, s) = radius; values (n, m, ...)."""
    for axis in range(2):
        r = int(min(radius[axis], values.shape[axis]))
        pad = [(0, 0)] * values.ndim
        pad[axis] = (r, r)
        wide = np.moveaxis(np.pad(values, pad, mode="edge"), axis, 0)
        n = values.shape[axis]
        values = np.moveaxis(extremum.reduce([wide[k : k + n] for k in range(2 * r + 1)]), 0, axis)
    return values


def _common_box(dhfs: Sequence[Dhf]) -> tuple[F64, F64]:
    """Lowest and highest corner, in the normalised frame, of a box around the domain boxes' intersection.

    The whole surface lies inside it.
    """
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    for dhf in dhfs:
        corners = dhf.bounds[[0, 1, 2], _indices([2, 2, 2])].astype(np.float64) @ dhf.record.rotation
        lo, hi = np.maximum(lo, corners.min(axis=0)), np.minimum(hi, corners.max(axis=0))
    return lo - BOX_MARGIN, np.maximum(lo, hi) + BOX_MARGIN


def _indices(shape: Sequence[int] | I64) -> I64:
    """Indices (N, 3) of an array of that shape, last one fastest."""
    return np.indices(tuple(shape)).reshape(3, -1).T
