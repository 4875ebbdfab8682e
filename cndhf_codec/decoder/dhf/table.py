"""Height tables: a DHF's heights at a regular grid over its domain, interpolated bilinearly, and bounds of them.

For grids of nodes in space: to evaluate the network at every node would take tens of times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np

from ...arrays import F32, F64
from ..parallel import matmul
from .field import Dhf

Extremum = Callable[[F32, F32], F32]  # np.minimum or np.maximum


class HeightTable:
    """Near and far height of one DHF at nodes that are at most `spacing` apart (normalised units).

    Bilinear, not cubic: next to a silhouette, where heights bend most, a cubic would overshoot.
    """

    def __init__(self, dhf: Dhf, spacing: float) -> None:
        lo, hi = dhf.bounds[:2, 0], dhf.bounds[:2, 1]
        self.lo = lo
        self.shape = np.maximum(np.ceil((hi - lo) / spacing).astype(np.int64) + 1, 2)
        self.step = (hi - lo) / (self.shape - 1).astype(np.float32)
        u, v = (np.linspace(lo[k], hi[k], self.shape[k], dtype=np.float32) for k in range(2))
        heights = dhf.heights(np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2))
        self.values = heights.T.reshape(2, *self.shape)  # near, far

    def __call__(self, u: F32, v: F32) -> tuple[F32, F32]:
        """u, v (N,) -> near and far heights (N,) each; beyond the table's edge, those at the edge."""
        near, far = (self.height(side, self.steps(u, 0), self.steps(v, 1)) for side in range(2))
        return near, far

    def steps(self, x: F32, axis: int) -> F32:
        """Coordinates u (axis 0) or v (axis 1), in steps from the first node."""
        x = x - self.lo[axis]
        x /= self.step[axis]
        return x

    def height(self, side: int, u: F32, v: F32) -> F32:
        """Near (side 0) or far (side 1) height (N,) at u and v (N,) in steps. Overwrites u and v."""
        cells = []
        for x, nodes in zip((u, v), self.shape, strict=True):
            # The greatest number below the last node's is still in the last cell.
            np.clip(x, 0, np.nextafter(np.float32(nodes - 1), np.float32(0)), out=x)
            cells.append(x.astype(np.int32))
            x -= cells[-1].astype(np.float32)
        nv = int(self.shape[1])
        at, j = cells
        at *= nv
        at += j
        at = at.astype(np.intp)
        heights = self.values[side].ravel()
        a, b = heights.take(at), heights[nv:].take(at)
        a += (heights[1:].take(at) - a) * v
        b += (heights[nv + 1 :].take(at) - b) * v
        b -= a
        b *= u
        a += b
        return a

    def solid_box(self, dhf: Dhf) -> tuple[F64, F64]:
        """Lowest and highest corner (3,), in the normalised frame, of a box around the surface at nodes in the solid.

        A node is in the solid where far >= near. Without any, the corners are inf and -inf.
        """
        near, far = self.values
        at = np.flatnonzero(far >= near)
        uvz = np.empty((3, len(at)), dtype=np.float32)
        for k, number in enumerate(np.divmod(at, near.shape[1])):
            uvz[k] = self.lo[k] + self.step[k] * number.astype(np.float32)
        lo, hi = np.full(3, np.inf), np.full(3, -np.inf)
        for heights in (near, far):
            uvz[2] = np.clip(heights.ravel()[at], *dhf.bounds[2])
            points = matmul(dhf.rotation.T, uvz)
            lo = np.minimum(lo, points.min(axis=1, initial=np.inf))
            hi = np.maximum(hi, points.max(axis=1, initial=-np.inf))
        return lo, hi


class HeightBounds:
    """Least and greatest heights that a table gives in a rectangle of fixed size, wherever it lies."""

    def __init__(self, table: HeightTable, size: F32) -> None:
        """size: (2,) sides of the rectangle along u and v, normalised units."""
        self.lo, self.step, self.last = table.lo, table.step, table.shape - 2
        # As many nodes as interpolation anywhere in the rectangle reads, and one more for rounding.
        nodes = np.floor(size / table.step).astype(int) + 4
        self.pool = max(1, int(nodes.min()) // 8)
        windows = (nodes - 2) // self.pool + 2
        bounds = []
        for extremum in (np.minimum, np.maximum):
            pooled = table.values
            for axis in (1, 2):
                pooled = _sliding(_pooled(pooled, extremum, axis, self.pool), extremum, axis, int(windows[axis - 1]))
            bounds += list(pooled)
        self.values = np.stack(bounds)

    def __call__(self, u: F32, v: F32) -> F32:
        """Lowest corners u, v (N,) of rectangles -> (4, N): least near, least far, greatest near, greatest far."""
        at = []
        for k, x in enumerate((u, v)):
            node = np.floor((x - self.lo[k]) / self.step[k] - np.float32(0.01))
            at.append(np.clip(node, 0, self.last[k]).astype(np.int32) // self.pool)
        return self.values.reshape(4, -1).take(at[0] * self.values.shape[2] + at[1], axis=1)


def _pooled(values: F32, extremum: Extremum, axis: int, size: int) -> F32:
    """Extrema of groups of `size` values along `axis`; the last group may be smaller."""
    a = np.moveaxis(values, axis, 0)
    a = np.concatenate([a, np.repeat(a[-1:], -len(a) % size, axis=0)])
    return np.moveaxis(reduce(extremum, [a[k::size] for k in range(size)]), 0, axis)


def _sliding(values: F32, extremum: Extremum, axis: int, size: int) -> F32:
    """Extrema of `size` values along `axis`, starting at each; fewer at the end."""
    a = np.moveaxis(values, axis, 0)
    n = len(a)
    a = np.concatenate([a, np.repeat(a[-1:], size - 1, axis=0)])
    width = 1
    while width < size:
        shift = min(width, size - width)
        a = extremum(a[: len(a) - shift], a[shift:])
        width += shift
    return np.moveaxis(a[:n], 0, axis)
