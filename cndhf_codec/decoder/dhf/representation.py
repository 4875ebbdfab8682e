"""The representation `dhf`: an intersection of double height fields, as `Model` asks for it."""

from __future__ import annotations

import math
import threading
import warnings
from typing import Any, Final

import numpy as np

from ...arguments import length, real_number
from ...arrays import F32, F64, Mask
from ...errors import CndhfWarning, OptionError, SurfaceError
from ...format import Container
from ..limits import Limits
from ..queries import TriangleQueries
from ..representation import Detail
from ..results import NearestPoints, OccupancyGrid, RayHits, ShadedMesh, TriangleMesh
from .field import implicit, implicit_gradient
from .solid import DhfSolid

# Evidence for these constants: ADR 031; DEFAULT_RESOLUTION: 028; DEFAULT_MAX_ERROR: 030.
# Points are clamped to this distance (normalised units; a DHF's box ends at 2), because float32 would overflow on
# greater ones. They stay outside.
MAX_COORDINATE = np.float32(2**20)
POINTS_WORTH_CELLS = 2**18  # points asked for, over all calls, from which on cells save more time than they take
DEFAULT_RESOLUTION = 256
DEFAULT_MAX_ERROR = "0.02%"  # of an intersection: far less than what the smallest files lose


class DhfRepresentation:
    """See `decoder.representation.Representation`."""

    kind: Final = "dhf"
    points_at_once = 2**16

    def __init__(self, container: Container) -> None:
        self.solid = DhfSolid(container.dhfs)
        self.points_asked = 0
        self._container = container
        self._scale = container.scale
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
        if detail.level is not None:
            raise OptionError("level belongs to surfaces; this file holds double height fields: give a resolution")
        chosen = detail.method is not None or detail.resolution is not None
        asked = DEFAULT_RESOLUTION if detail.resolution is None else detail.resolution
        resolution = limits.check(self._container, asked)
        if detail.method not in (None, "marching-cubes", "intersection"):
            raise OptionError(f"method is {detail.method!r}; there are 'marching-cubes' and 'intersection'")
        if detail.method != "intersection" and (detail.max_error is not None or detail.faces is not None):
            raise OptionError("max_error and faces belong to method 'intersection'")
        if detail.method == "intersection":
            return self._intersection(detail.max_error, detail.faces, resolution, limits)
        if not chosen:
            return self.whole(resolution, limits)
        self._warn_of_thin_walls(resolution)
        return self.solid.isosurface(resolution, limits)

    def whole(self, resolution: int, limits: Limits) -> TriangleMesh:
        """The surface by marching cubes or, where walls are thinner than a cell of the default resolution, whole by
        intersection. Raises SurfaceError."""
        if self.solid.thinner_than_a_cell(DEFAULT_RESOLUTION):
            return self._intersection(None, None, DEFAULT_RESOLUTION, limits)
        return self.solid.isosurface(resolution, limits)

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
        self._warn_of_thin_walls(resolution)
        return self.solid.occupancy(resolution, limits)

    def _intersection(
        self, max_error: float | str | None, faces: int | None, resolution: int, limits: Limits
    ) -> TriangleMesh:
        """The surface by intersection, or with a warning by marching cubes, should that fail."""
        if max_error is not None and faces is not None:
            raise OptionError("give max_error or faces, not both")
        if faces is not None and not real_number(faces, "faces") >= 4:
            raise OptionError(f"faces is {faces}; a solid has at least 4")
        rough = self.solid.rough_surface(limits)
        error = None
        if faces is None:
            error = length(DEFAULT_MAX_ERROR if max_error is None else max_error, rough.diagonal, self._scale)
            thin = self.solid.thinner_than_a_cell(DEFAULT_RESOLUTION)
            if thin is not None and max_error is None:
                error = min(error, thin.typical / 20)
        try:
            return self.solid.intersection(error, None if faces is None else int(faces), rough, limits)
        except SurfaceError as exc:
            _warn(f"no intersection ({exc}); the surface is that of marching cubes")
            self._warn_of_thin_walls(resolution)
            return self.solid.isosurface(resolution, limits)

    def _warn_of_thin_walls(self, resolution: int) -> None:
        # Against the default resolution at least: that a coarser grid loses thin walls needs no warning.
        thin = self.solid.thinner_than_a_cell(max(resolution, DEFAULT_RESOLUTION))
        if thin is not None:
            _warn(
                f"parts of the solid, {thin.least * self._scale:.3g} thick, are thinner than a cell of "
                f"resolution {resolution} and may come out torn or not at all: leave resolution and method to the "
                f"default, take the method intersection, or a resolution of {math.ceil(thin.resolution)} and more"
            )


def _warn(text: str) -> None:
    # Here, `_warn`'s caller, `mesh` or `occupancy`, `Model`: then the line that called `Model`.
    warnings.warn(text, CndhfWarning, stacklevel=5)


def _clamped(points: F64) -> F32:
    """Points (N, 3) as float32, within the range where heights do not overflow."""
    with np.errstate(over="ignore"):
        return np.clip(points.astype(np.float32), -MAX_COORDINATE, MAX_COORDINATE)


def _outward(gradient: F32) -> F32:
    """The outward unit normals (..., 3) of a surface where f has these gradients (..., 3)."""
    norm = np.linalg.norm(gradient, axis=-1, keepdims=True)
    # A gradient is zero only for points that are not finite: flat heights have slope 1 along their axis.
    return np.divide(-gradient, norm, out=np.zeros_like(gradient), where=norm > 0)
