"""The mesh of a file of double height fields that was asked for: by which method, how fine, how much simplified."""

from __future__ import annotations

import math
import sys
import warnings

import numpy as np

from ...arguments import length, whole_in
from ...arrays import F64
from ...errors import CndhfWarning, OptionError, SurfaceError
from ...format import Container
from ..file_error import measured_errors
from ..limits import Limits
from ..pieces import without_specks
from ..queries import TriangleQueries
from ..representation import Detail
from ..results import TriangleMesh
from ..simplify import LEAST_FACES, simplified, with_faces
from .solid import DhfSolid

# Evidence for these constants: ADR 040; DEFAULT_RESOLUTION: 028; DEFAULT_MAX_ERROR: 030.
DEFAULT_RESOLUTION = 256  # of files without a measured error, and the finest of those with one
LEAST_RESOLUTION = 128  # by default: a coarser grid loses thin parts
CELL_OF_MEAN_ERROR = 12.0  # a cell is so many times as long: marching cubes then adds about a hundredth to the error
TOLERANCE = 0.5  # times the mean error, of the simplification: adds 1 to 4 % to it
MOST_FACES = 2**20  # that are simplified by default: only files of noise have more
DEFAULT_MAX_ERROR = "0.02%"  # of an intersection: far less than what the smallest files lose
# For an error asked for: cells are so many times as long, and no more than this along the longest side.
CELL_OF_ERROR, FINEST_RESOLUTION = 3.0, 384
FIRST_TOLERANCE, TRIES = 0.4, 3  # times that error; halved until the mesh that is made keeps to it
BEYOND = 0.001  # share of the vertices that need not keep to it: for the last few, meshes get twice as many triangles
PACKAGE = __name__.split(".")[0] + "."


class Meshes:
    """Meshes of a solid. scale: of the normalised frame, for lengths in input units and messages."""

    def __init__(self, container: Container, solid: DhfSolid) -> None:
        self._container, self._solid = container, solid
        self._scale, self._errors = container.scale, measured_errors(container)

    def mesh(self, detail: Detail, limits: Limits) -> TriangleMesh:
        """The mesh that was asked for. Raises OptionError or SurfaceError."""
        if detail.level is not None:
            raise OptionError("level belongs to surfaces; this file holds double height fields: give a resolution")
        if detail.method not in (None, "marching-cubes", "intersection"):
            raise OptionError(f"method is {detail.method!r}; there are 'marching-cubes' and 'intersection'")
        if detail.max_error is not None and detail.faces is not None:
            raise OptionError("give max_error or faces, not both")
        faces = None if detail.faces is None else whole_in(detail.faces, "faces", LEAST_FACES)
        error = None
        if detail.max_error is not None:
            error = length(detail.max_error, self._solid.rough_surface(limits).diagonal, self._scale)
        chosen = detail.resolution is not None or detail.method == "marching-cubes"
        if detail.method == "intersection" or (not chosen and self._thin()):
            found, whole = self._intersection(error, detail.resolution, limits), True
        else:
            asked = self._resolution(error) if detail.resolution is None else detail.resolution
            resolution = limits.check(self._container, asked)
            if chosen:
                self.warn_of_thin_walls(resolution)
            found, whole = self._solid.isosurface(resolution, limits), False
        if self._errors is not None and not detail.specks:
            found = without_specks(found, self._errors.p99)
        if faces is not None:
            return with_faces(found, faces)
        if error is not None and not whole:
            return _within(found, error)
        if chosen or whole or self._errors is None or len(found.faces) > MOST_FACES:
            return found
        return simplified(found, self._errors.tolerance(TOLERANCE, _diagonal(found)))

    def whole(self, resolution: int, limits: Limits) -> TriangleMesh:
        """The surface by marching cubes, not simplified; or, where walls are thinner than a cell of the default
        resolution, whole by intersection. Raises SurfaceError."""
        if self._thin():
            return self._intersection(None, None, limits)
        found = self._solid.isosurface(limits.check(self._container, resolution), limits)
        return found if self._errors is None else without_specks(found, self._errors.p99)

    def warn_of_thin_walls(self, resolution: int) -> None:
        """Warn where walls are thinner than a cell."""
        # Against the default resolution at least: that a coarser grid loses thin walls needs no warning.
        thin = self._solid.thinner_than_a_cell(max(resolution, DEFAULT_RESOLUTION))
        if thin is not None:
            _warn(
                f"parts of the solid, {thin.least * self._scale:.3g} thick, are thinner than a cell of "
                f"resolution {resolution} and may come out torn or not at all: leave resolution and method to the "
                f"default, take the method intersection, or a resolution of {math.ceil(thin.resolution)} and more"
            )

    def _thin(self) -> bool:
        return self._solid.thinner_than_a_cell(DEFAULT_RESOLUTION) is not None

    def _resolution(self, error: float | None) -> int:
        """By the error asked for, or else by that of the file."""
        if error is not None:
            cell, finest = CELL_OF_ERROR * error, FINEST_RESOLUTION
        elif self._errors is not None:
            cell, finest = CELL_OF_MEAN_ERROR * self._errors.mean, DEFAULT_RESOLUTION
        else:
            return DEFAULT_RESOLUTION
        thickness = self._solid.thickness()
        if thickness is None or thickness.longest >= finest * cell:
            return finest
        return max(math.ceil(thickness.longest / cell), LEAST_RESOLUTION)

    def _intersection(self, error: float | None, resolution: int | None, limits: Limits) -> TriangleMesh:
        """The surface by intersection, or with a warning by marching cubes, should that fail."""
        resolution = limits.check(self._container, DEFAULT_RESOLUTION if resolution is None else resolution)
        rough = self._solid.rough_surface(limits)
        if error is None:
            error = length(DEFAULT_MAX_ERROR, rough.diagonal, self._scale)
            thin = self._solid.thinner_than_a_cell(DEFAULT_RESOLUTION)
            if thin is not None:
                error = min(error, thin.typical / 20)
        try:
            return self._solid.intersection(error, rough, limits)
        except SurfaceError as exc:
            _warn(f"no intersection ({exc}); the surface is that of marching cubes")
            self.warn_of_thin_walls(resolution)
            return self._solid.isosurface(resolution, limits)


def _within(mesh: TriangleMesh, error: float) -> TriangleMesh:
    """Simplify a mesh as far as its vertices, but for `BEYOND` of them, stay within an error of the result."""
    tolerance = FIRST_TOLERANCE * error
    for _ in range(TRIES):
        out = simplified(mesh, tolerance)
        if np.quantile(TriangleQueries(*out).nearest(mesh.vertices).distance, 1 - BEYOND) <= error:
            return out
        tolerance /= 2
    return mesh


def _diagonal(mesh: TriangleMesh) -> float:
    ends: F64 = np.ptp(mesh.vertices, axis=0)
    return float(np.linalg.norm(ends))


def _warn(text: str) -> None:
    """Warn, naming the line outside this package that asked."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, CndhfWarning, stacklevel=level - 1)
