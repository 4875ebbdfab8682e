"""The representation `dhf`: an intersection of double height fields, as `Model` asks for it."""

from __future__ import annotations

import threading
from typing import Any, Final

import numpy as np

from ...arrays import F32, F64, Mask
from ...format import Container
from ..limits import Limits
from ..queries import TriangleQueries
from ..representation import Detail
from ..results import NearestPoints, OccupancyGrid, RayHits, ShadedMesh, TriangleMesh
from .field import implicit, implicit_gradient
from .meshes import Meshes
from .solid import DhfSolid

# Evidence for these constants: ADR 031.
# Points are clamped to this distance (normalised units; a DHF's box ends at 2), because float32 would overflow on
# greater ones. They stay outside.
MAX_COORDINATE = np.float32(2**20)
POINTS_WORTH_CELLS = 2**18  # points asked for, over all calls, from which on cells save more time than they take


class DhfRepresentation:
    """See `decoder.representation.Representation`."""

    kind: Final = "dhf"
    points_at_once = 2**16

    def __init__(self, container: Container) -> None:
        self.solid = DhfSolid(container.dhfs)
        self.points_asked = 0
        self._container = container
        self._meshes = Meshes(container, self.solid)
        self._queries: TriangleQueries | None = None
        self._lock = threading.Lock()

    def describe(self, size: int) -> dict[str, Any]:
        dhfs = self._container.dhfs
        parameters = sum(d.parameters for d in dhfs)
        return {
            "dhfs": [
                {
                    "axis": [round(float(x), 6) for x in d.rotation[2]],
                    "mirrored": [name for name, m in zip("uv", d.mirrors, strict=True) if m is not None],
                    "width": d.width,
                    "hidden_layers": d.hidden_layers,
                    "parameters": d.parameters,
                    "bounds": [[float(x) for x in row] for row in d.bounds],
                }
                for d in dhfs
            ],
            "parameters": parameters,
            "bits_per_parameter": 8 * size / parameters,
        }

    def prepare(self, n_points: int) -> None:
        self.points_asked += n_points  # two threads at once may lose a count, which does no harm
        if self.points_asked >= POINTS_WORTH_CELLS:
            self.solid.cells()

    def contains(self, points: F64) -> Mask:
        if not self.solid.has_cells:
            return np.asarray(self.implicit(points) >= 0)
        with np.errstate(over="ignore"):
            return self.solid.cells().contains(points.astype(np.float32))

    def implicit(self, points: F64) -> F32:
        return implicit(self.solid.dhfs, _clamped(points))

    def implicit_gradient(self, points: F64) -> tuple[F32, F32]:
        return implicit_gradient(self.solid.dhfs, _clamped(points))

    def normals(self, points: F64) -> F32:
        return _outward(self.implicit_gradient(points)[1])

    def distance(self, points: F64) -> F64:
        return self._of_mesh().distance(points)

    def nearest(self, points: F64) -> NearestPoints:
        return self._of_mesh().nearest(points)

    def _of_mesh(self) -> TriangleQueries:
        with self._lock:  # the first thread makes it, others wait
            if self._queries is None:
                self._queries = TriangleQueries(*self.mesh(Detail(), Limits()))
            return self._queries

    def first_hits(self, origins: F64, directions: F64) -> RayHits:
        from .rays import first_crossings

        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            d = directions / np.abs(directions).max(axis=1, keepdims=True)  # else its square may overflow or vanish
            d /= np.linalg.norm(d, axis=1, keepdims=True)
        t = first_crossings(self.solid.cells(), origins, d)
        point, normal = np.full_like(origins, np.nan), np.full_like(origins, np.nan)
        hit = np.flatnonzero(np.isfinite(t))
        point[hit] = origins[hit] + t[hit, None] * d[hit]
        normal[hit] = self.normals(point[hit])
        return RayHits(t, point, normal)

    def mesh(self, detail: Detail, limits: Limits) -> TriangleMesh:
        return self._meshes.mesh(detail, limits)

    def whole(self, resolution: int, limits: Limits) -> TriangleMesh:
        """See `Meshes.whole`."""
        return self._meshes.whole(resolution, limits)

    def shaded_mesh(self, detail: Detail, limits: Limits) -> ShadedMesh:
        vertices, faces = self.mesh(detail, limits)
        return ShadedMesh(vertices, faces, self._normals_of(vertices))

    def _normals_of(self, vertices: F64) -> F32:
        """(N, 3) normals, in pieces."""
        out = np.empty((len(vertices), 3), dtype=np.float32)
        for first in range(0, len(vertices), self.points_at_once):
            part = slice(first, first + self.points_at_once)
            out[part] = self.normals(vertices[part])
        return out

    def occupancy(self, resolution: int, limits: Limits) -> OccupancyGrid:
        resolution = limits.check(self._container, resolution)
        self._meshes.warn_of_thin_walls(resolution)
        return self.solid.occupancy(resolution, limits)


def _clamped(points: F64) -> F32:
    """Points (N, 3) as float32, within the range where heights do not overflow."""
    with np.errstate(over="ignore"):
        return np.clip(points.astype(np.float32), -MAX_COORDINATE, MAX_COORDINATE)


def _outward(gradient: F32) -> F32:
    """The outward unit normals (..., 3) of a surface where f has these gradients (..., 3)."""
    norm = np.linalg.norm(gradient, axis=-1, keepdims=True)
    # A gradient is zero only for points that are not finite: flat heights have slope 1 along their axis.
    return np.divide(-gradient, norm, out=np.zeros_like(gradient), where=norm > 0)
