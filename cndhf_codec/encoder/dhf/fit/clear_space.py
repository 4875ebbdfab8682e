"""Clear space: cells of a grid over the domain boxes that are far from the solid. Anything solid there is a floater."""

from __future__ import annotations

import numpy as np

from ....arrays import F32, Mask
from ....mesh.solid import Solid
from ..frames import Frame
from .samples import CLEARANCE, OppositeSamples, excluded_points, in_box


class ClearSpace:
    """Clear space, from which points can be drawn; tells the truth about any point."""

    def __init__(self, solid: Solid, frames: list[Frame], sides: OppositeSamples, cells: int = 64) -> None:
        """sides: of the space samples. cells: per side of the grid."""
        self._solid, self._frames, self._sides = solid, frames, sides
        lo, hi = frames[0].bounds.T
        self._cell = (hi - lo) / cells
        grid = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        corners = lo + grid * self._cell
        centres = (corners + self._cell / 2) @ frames[0].rotation
        reach = float(np.linalg.norm(self._cell)) / 2
        in_boxes = np.ones(len(centres), dtype=bool)
        for f in frames[1:]:
            uvz = centres @ f.rotation.T
            in_boxes &= ((uvz > f.bounds[:, 0] - reach) & (uvz < f.bounds[:, 1] + reach)).all(axis=1)
        corners, centres = corners[in_boxes], centres[in_boxes]
        distance = solid.distances(centres)
        away = distance > reach + CLEARANCE
        corners, centres, distance = corners[away], centres[away], distance[away]
        excluded = excluded_points(solid, frames, centres)
        clear = sides.nearer(centres, excluded, distance) > reach + CLEARANCE
        self._corners = corners[clear & excluded.any(axis=1)]

    def draw(self, count: int, rng: np.random.Generator) -> F32:
        """Draw about `count` points (n, 3) of the normalised frame; fewer where cells jut out of a domain box."""
        if not len(self._corners):
            return np.empty((0, 3), dtype=np.float32)
        cells = rng.integers(len(self._corners), size=count)
        uvz = self._corners.take(cells, axis=0) + rng.random((count, 3)) * self._cell
        points = uvz @ self._frames[0].rotation
        inside = np.ones(count, dtype=bool)
        for f in self._frames[1:]:
            inside &= in_box(f, points)
        return points[inside].astype(np.float32)

    def truth(self, points: F32) -> tuple[Mask, F32]:
        """Tell which fields' exact heights exclude points (N, 3), (N, K), and their distance from the surface, (N,)."""
        wide = points.astype(np.float64)
        excluded = excluded_points(self._solid, self._frames, wide)
        distance = self._sides.nearer(wide, excluded, self._solid.distances(wide))
        return excluded, distance.astype(np.float32)
