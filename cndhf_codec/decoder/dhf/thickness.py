"""How thick a solid is along the axes of its double height fields, which tells how fine a grid must be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import F32
from ..parallel import matmul
from .field import Dhf, implicit

# Evidence for these constants: ADR 030.
SAMPLES_PER_SIDE = 128  # of a domain
# Share of a field's samples that may be thinner than the thickness reported. Measured: of 38 solids, from scans to
# assemblies, this share is thinner than 1/90 of the longest side in four (a bed, a chair, a table, a drone: 1/122 to
# 1/229); all of a plate of 1/500 is.
THIN_SHARE = 0.05


@dataclass(frozen=True)
class Thickness:
    """Thickness of a solid, in normalised units.

    longest: side of the solid's box. least: of the fields' 5 % quantiles, the least. typical: of the fields' medians,
    the least.
    """

    longest: float
    least: float
    typical: float

    @property
    def resolution(self) -> float:
        """Cells along the longest side at which a cell is as thick as `least`."""
        return self.longest / self.least


def thickness(dhfs: Sequence[Dhf]) -> Thickness | None:
    """Measure far - near at regular samples of each domain where the solid is; None for an empty solid."""
    lo, hi = np.full(3, -np.inf), np.full(3, np.inf)
    least, typical = np.inf, np.inf
    for dhf in dhfs:
        steps = (np.arange(SAMPLES_PER_SIDE, dtype=np.float32) + np.float32(0.5)) / np.float32(SAMPLES_PER_SIDE)
        u, v = (low + (high - low) * steps for low, high in dhf.bounds[:2])
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        near, far = np.clip(dhf.heights(uv), *dhf.bounds[2]).T
        at = np.flatnonzero(far > near)
        if not len(at):
            return None
        ends = [_to_normalised(dhf, uv[at], heights[at]) for heights in (near, far)]
        both = np.concatenate(ends)
        lo, hi = np.maximum(lo, both.min(axis=0)), np.minimum(hi, both.max(axis=0))
        # Where another field cuts the middle away, this field's heights do not bound the solid.
        middle: F32 = ends[0] + (ends[1] - ends[0]) * np.float32(0.5)
        inside = implicit(dhfs, middle) > 0
        if inside.any():
            through = (far - near)[at][inside]
            least = min(least, float(np.quantile(through, THIN_SHARE)))
            typical = min(typical, float(np.median(through)))
    longest = float((hi - lo).max())
    return Thickness(longest, least, typical) if 0 < least < np.inf and longest > 0 else None


def _to_normalised(dhf: Dhf, uv: F32, heights: F32) -> F32:
    """(N, 2) and (N,) in the DHF's frame -> (N, 3) in the normalised frame."""
    return matmul(dhf.rotation.T, np.column_stack([uv, heights]).T).T
