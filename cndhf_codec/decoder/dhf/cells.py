"""Cells of space: which are surely inside the solid, surely outside, or to be asked of which network.

A query looks its point's cell up and evaluates networks only near the surface. What is sure rests on bounds of
the heights over patches of their plane, measured when the cells are made; a model whose heights are too rough to
be measured so has no sure cells, and is slow but right.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I64, Mask
from ..parallel import product
from .field import Dhf

CELLS = 128  # along the longest side of the solid
BLOCK = 4  # cells along the edge of a block, the coarse level
BLOCKS_AT_ONCE = 2**11  # divided into cells; memory
PATCHES = 256  # along the longer side of a DHF's domain

# A smooth function strays from the bilinear interpolation of a patch's corners by at most an eighth of its greatest
# second differences along both sides. They are known at nodes only: taken from the neighbours too, and four times
# as large, they held at all of 4e7 random points of 41 fitted DHFs, as twice or without neighbours they did not.
SAFETY = 4.0
ROUNDING = 1e-5  # added to every bound: ten times what float32 evaluation differs by, in normalised units

MARGIN = 10 * ROUNDING  # of the cells' box around the solid

NEIGHBOURS = np.array([1, 1])

SHARED = 7  # DHF i has bit i % SHARED of a cell's state
INSIDE, OUTSIDE = 0, 0xFF
ANY = OUTSIDE - 0x80  # all bits: any DHF may matter


class CellGrid:
    """The cells of a box around the solid, in the normalised frame."""

    def __init__(self, dhfs: Sequence[Dhf]) -> None:
        self._dhfs = dhfs
        bounds = [PatchBounds(dhf) for dhf in dhfs]
        lo, hi = _common_box(dhfs)
        # Once to find the solid's box, and once in that.
        for _ in range(2):
            self.edge = float((hi - lo).max()) / CELLS
            n = np.maximum(np.ceil((hi - lo) / (BLOCK * self.edge)).astype(int), 1)  # blocks
            self.origin = (lo + hi) / 2 - n / 2 * (BLOCK * self.edge)
            blocks = self._states(bounds, _indices(n), BLOCK, np.full(n.prod(), ANY, np.uint8)).reshape(n)
            at = np.argwhere(blocks != OUTSIDE)
            if not len(at):
                break
            lo, hi = (self.origin + (k * BLOCK) * self.edge for k in (at.min(axis=0), at.max(axis=0) + 1))
        states = np.empty((*n, BLOCK, BLOCK, BLOCK), np.uint8)
        states[...] = blocks[..., None, None, None]
        mixed = np.argwhere((blocks != OUTSIDE) & (blocks != INSIDE))
        for part in (mixed[k : k + BLOCKS_AT_ONCE] for k in range(0, len(mixed), BLOCKS_AT_ONCE)):
            children = (part[:, None] * BLOCK + _indices([BLOCK] * 3)).reshape(-1, 3)
            parents = np.repeat(blocks[tuple(part.T)], BLOCK**3)
            states[tuple(part.T)] = self._states(bounds, children, 1, parents).reshape(-1, BLOCK, BLOCK, BLOCK)
        joined = states.transpose(0, 3, 1, 4, 2, 5).reshape(n * BLOCK)
        # A border of outside cells takes whatever lies beyond the box.
        self.shape = n * BLOCK + 2
        self.states = np.pad(joined, 1, constant_values=OUTSIDE).ravel()

    @property
    def box(self) -> tuple[F64, F64]:
        """Least and greatest corner of a box that holds the solid."""
        return self.origin, self.origin + (self.shape - 2) * self.edge

    @cached_property
    def beside(self) -> npt.NDArray[np.uint8]:
        """1 for cells that the surface may pass or that touch such a cell, else 0; for `lookup`."""
        out = ((self.states != INSIDE) & (self.states != OUTSIDE)).reshape(self.shape)
        for axis in range(3):
            old = out.copy()
            np.moveaxis(out, axis, 0)[1:] |= np.moveaxis(old, axis, 0)[:-1]
            np.moveaxis(out, axis, 0)[:-1] |= np.moveaxis(old, axis, 0)[1:]
        return out.astype(np.uint8).ravel()

    def lookup(self, points: F32, states: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """The value in `states`, one a cell with the border, of the cells of (N, 3) normalised points."""
        flat = np.zeros(len(points), np.intp)
        for k in range(3):
            with np.errstate(invalid="ignore", over="ignore"):
                g = points[:, k] - np.float32(self.origin[k] - self.edge)
                g /= np.float32(self.edge)
                cell = g.astype(np.int32).view(np.uint32)
            # As unsigned numbers what is below zero or not finite is huge (or 0, which is border too).
            flat *= self.shape[k]
            flat += np.minimum(cell, np.uint32(self.shape[k] - 1), out=cell)
        return states[flat]

    def contains(self, points: F32) -> Mask:
        """(N, 3) points of the normalised frame -> (N,): as the sign of f from the networks themselves."""
        state = self.lookup(points, self.states)
        inside = state == INSIDE
        asked = np.flatnonzero((state != OUTSIDE) & ~inside)
        for i, dhf in enumerate(self._dhfs):
            unsure = (state[asked] >> (i % SHARED)) & 1 > 0
            outside = np.zeros(len(asked), bool)
            outside[unsure] = ~(dhf.implicit(points[asked[unsure]]) >= 0)
            asked = asked[~outside]
        inside[asked] = True
        return inside

    def _states(
        self, bounds: Sequence[PatchBounds], cells: I64, edge: int, parents: npt.NDArray[np.uint8]
    ) -> npt.NDArray[np.uint8]:
        """States of cubes of `edge` cells, given by their (N, 3) positions in such cubes.

        parents: states of cubes that hold them. A DHF without a bit there has none here.
        """
        half = edge * self.edge / 2 + ROUNDING
        centres = (self.origin + (cells + 0.5) * (edge * self.edge)).T
        out = np.zeros(len(cells), np.uint8)
        for i, bound in enumerate(bounds):
            bit = np.uint8(1 << (i % SHARED))
            asked = np.flatnonzero((parents & bit > 0) & (out != OUTSIDE))
            outside, inside = bound.cubes(centres[:, asked], half)
            out[asked[~inside]] |= bit
            out[asked[outside]] = OUTSIDE
        return out


class PatchBounds:
    """Least and greatest near and far height of one DHF over each patch of a regular grid on its domain."""

    def __init__(self, dhf: Dhf) -> None:
        self._rotation, self._box = dhf.record.rotation, dhf.bounds.astype(np.float64)
        lo, hi = self._box[:2].T
        self.shape = np.maximum(np.ceil((hi - lo) / (hi - lo).max() * PATCHES).astype(int), 1)
        self.lo, self.size = lo, (hi - lo) / self.shape
        # Nodes at the patches' corners, the middles of their sides and their centres.
        u, v = (lo[k] + self.size[k] / 2 * np.arange(2 * self.shape[k] + 1) for k in range(2))
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).astype(np.float32)
        values = dhf.heights(uv.reshape(-1, 2)).reshape(uv.shape)
        least, greatest = _patch_bounds(values, 2)
        # Bounds that follow from the corners alone must hold at the other nodes. Where they do not, the heights are
        # rougher than nodes can tell, and nothing is known there and next to there.
        low, high = _patch_bounds(values[::2, ::2], 1)
        smooth = (low <= _over_patches(values, 2, np.minimum)) & (_over_patches(values, 2, np.maximum) <= high)
        rough = _window(~smooth, NEIGHBOURS, np.logical_or).any(axis=-1)
        least[rough], greatest[rough] = -np.inf, np.inf
        self._bounds = [least[..., 0], greatest[..., 0], least[..., 1], greatest[..., 1]]

    def cubes(self, centres: F64, half: float) -> tuple[Mask, Mask]:
        """Which cubes, of half-edge `half` and with centres (3, N) in the normalised frame, are surely outside,
        and which surely inside."""
        uvz = product(self._rotation, centres)
        reach = half * np.abs(self._rotation).sum(axis=1)
        patch = [np.clip(((uvz[k] - self.lo[k]) / self.size[k]).astype(int), 0, self.shape[k] - 1) for k in range(2)]
        window = np.ceil(reach[:2] / self.size).astype(int)
        flat = patch[0] * self.shape[1] + patch[1]
        near_least, near_greatest, far_least, far_greatest = (
            _window(b, window, pick).ravel()[flat]
            for b, pick in zip(self._bounds, (np.minimum, np.maximum) * 2, strict=True)
        )
        low, high = uvz[2] - reach[2], uvz[2] + reach[2]
        outside = (far_greatest < near_least) | (high < near_least) | (low > far_greatest)
        inside = (low > near_greatest) & (high < far_least)
        for x, r, (lo, hi) in zip(uvz, reach, self._box, strict=True):
            outside |= (x + r < lo) | (x - r > hi)
            inside &= (x - r > lo) & (x + r < hi)
        return outside, inside


def _patch_bounds(values: F32, nodes: int) -> tuple[F32, F32]:
    """(n * nodes + 1, m * nodes + 1, 2) heights at nodes -> least and greatest over n x m patches, each (n, m, 2)."""
    bend = np.zeros_like(values)
    for axis in range(2):
        v, b = np.moveaxis(values, axis, 0), np.moveaxis(bend, axis, 0)
        if len(v) > 2:
            d = np.abs(v[2:] - 2 * v[1:-1] + v[:-2])
            b[1:-1] += d
            b[0] += d[0]
            b[-1] += d[-1]
    margin: F32 = np.float32(SAFETY / 8) * _window(
        _over_patches(bend, nodes, np.maximum), NEIGHBOURS, np.maximum
    ) + np.float32(ROUNDING)
    return _over_patches(values, nodes, np.minimum) - margin, _over_patches(values, nodes, np.maximum) + margin


def _over_patches(values: F32, nodes: int, pick: np.ufunc) -> F32:
    """`pick` over the nodes of each patch, those on its border too."""
    for axis in range(2):
        v = np.moveaxis(values, axis, 0)
        n = (len(v) - 1) // nodes
        parts = [v[k : k + (n - 1) * nodes + 1 : nodes] for k in range(nodes + 1)]
        values = np.moveaxis(pick.reduce(parts), 0, axis)
    return values


def _window(values: npt.NDArray[Any], radius: I64, pick: np.ufunc) -> npt.NDArray[Any]:
    """`pick` over a patch and its neighbours, (2 r + 1) x (2 s + 1) of them, (r, s) = radius; values (n, m, ...)."""
    for axis in range(2):
        r = int(min(radius[axis], values.shape[axis]))
        pad = [(0, 0)] * values.ndim
        pad[axis] = (r, r)
        wide = np.moveaxis(np.pad(values, pad, mode="edge"), axis, 0)
        n = values.shape[axis]
        values = np.moveaxis(pick.reduce([wide[k : k + n] for k in range(2 * r + 1)]), 0, axis)
    return values


def _common_box(dhfs: Sequence[Dhf]) -> tuple[F64, F64]:
    """Box of the normalised frame around the domain boxes' intersection; all of the surface is inside it."""
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    for dhf in dhfs:
        corners = dhf.bounds[[0, 1, 2], _indices([2, 2, 2])].astype(np.float64) @ dhf.record.rotation
        lo, hi = np.maximum(lo, corners.min(axis=0)), np.minimum(hi, corners.max(axis=0))
    return lo - MARGIN, np.maximum(lo, hi) + MARGIN


def _indices(shape: Sequence[int] | I64) -> I64:
    """(N, 3) indices of an array of that shape, in order."""
    return np.indices(tuple(shape)).reshape(3, -1).T
