"""How thick a solid is along the axes of its double height fields: what grid can see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import F32
from ..parallel import product
from .field import Dhf, implicit

SIDE = 128  # samples along each side of a domain
# Share of what a field sees that one misses. Measured: of 38 solids, from scans to assemblies, 34 have as much below a
# 90th of their longest side, a bed, a chair, a table and a drone below a 122nd to a 229th, a plate of 1/500 all of it.
THIN = 0.05


@dataclass(frozen=True)
class Thickness:
    """longest: side of the solid's box. least: the twentieth of a field's heights lie below it, of the field that has
    the least such. typical: the least of the fields' medians. All in normalised units."""

    longest: float
    least: float
    typical: float

    @property
    def resolution(self) -> float:
        """Cells along the longest side from which on a cell is no thicker than the solid."""
        return self.longest / self.least


def thickness(dhfs: Sequence[Dhf]) -> Thickness | None:
    """The thickness at the middles of SIDE^2 cells of each domain, where the solid is; None where it is nowhere."""
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    least, typical = np.inf, np.inf
    for dhf in dhfs:
        steps = (np.arange(SIDE, dtype=np.float32) + np.float32(0.5)) / np.float32(SIDE)
        u, v = (low + (high - low) * steps for low, high in dhf.bounds[:2])
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        near, far = np.clip(dhf.heights(uv), *dhf.bounds[2]).T
        at = np.flatnonzero(far > near)
        if not len(at):
            return None
        ends = [_placed(dhf, uv[at], heights[at]) for heights in (near, far)]
        both = np.concatenate(ends)
        lo, hi = np.maximum(lo, both.min(axis=0)), np.minimum(hi, both.max(axis=0))
        # What other fields take away says nothing of the solid.
        middle: F32 = ends[0] + (ends[1] - ends[0]) * np.float32(0.5)
        inside = implicit(dhfs, middle) > 0
        if inside.any():
            through = (far - near)[at][inside]
            least = min(least, float(np.quantile(through, THIN)))
            typical = min(typical, float(np.median(through)))
    longest = float((hi - lo).max())
    return Thickness(longest, least, typical) if 0 < least < np.inf and longest > 0 else None


def _placed(dhf: Dhf, uv: F32, heights: F32) -> F32:
    """(N, 3) points of the normalised frame."""
    return product(dhf.rotation.T, np.column_stack([uv, heights]).T).T
