"""Height tables: a DHF's heights on a regular grid over its domain, looked up bilinearly.

For dense grids, where a network evaluation at every voxel would cost hundreds of times as much.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .dhf import Dhf
from .network import F32


class HeightTable:
    """Near and far height of one DHF at nodes that are at most `spacing` apart (normalised units)."""

    def __init__(self, dhf: Dhf, spacing: float) -> None:
        lo, hi = dhf.bounds[:2, 0], dhf.bounds[:2, 1]
        self.shape = np.maximum(np.ceil((hi - lo) / spacing).astype(np.int64) + 1, 2)
        self.lo = lo
        self.step = (hi - lo) / (self.shape - 1).astype(np.float32)
        u = lo[0] + self.step[0] * np.arange(self.shape[0], dtype=np.float32)
        v = lo[1] + self.step[1] * np.arange(self.shape[1], dtype=np.float32)
        self.uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
        self.values = dhf.heights(self.uv)  # (nu * nv, 2)

    def __call__(self, uv: F32) -> F32:
        """(N, 2) -> (N, 2), as `Dhf.heights`; the table's last row and column are used beyond its edge."""
        g = (uv - self.lo) / self.step
        np.clip(g, 0, (self.shape - 1).astype(np.float32), out=g)
        i = np.minimum(g.astype(np.int64), self.shape - 2)
        g -= i
        fu, fv = g[:, :1], g[:, 1:]
        nv = self.shape[1]
        at = i[:, 0] * nv + i[:, 1]
        t = self.values
        a = t[at] * (1 - fv) + t[at + 1] * fv
        b = t[at + nv] * (1 - fv) + t[at + nv + 1] * fv
        return a + (b - a) * fu

    def solid_corners(self, dhf: Dhf) -> npt.NDArray[np.float32]:
        """(M, 3) points of the normalised frame: near and far surface of every node where far >= near."""
        zlo, zhi = dhf.bounds[2]
        filled = self.values[:, 1] >= self.values[:, 0]
        uv, z = self.uv[filled], np.clip(self.values[filled], zlo, zhi)
        uvz = np.concatenate([np.column_stack([uv, z[:, 0]]), np.column_stack([uv, z[:, 1]])])
        return uvz @ dhf.rotation
