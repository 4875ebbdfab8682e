"""A solid as the intersection of double height fields, in the normalised frame, with the tables that queries need."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import SurfaceError
from ...format import DhfRecord
from ..limits import Limits
from ..results import OccupancyGrid, TriangleMesh
from .field import Dhf

if TYPE_CHECKING:
    from .cells import CellGrid
    from .isosurface import GridTables
    from .thickness import Thickness

# What surfaces, many points and rays need is imported where it is used, so that loading a file takes little time.

# Evidence for these constants: ADR 030; MAX_KEPT_RESOLUTION: 028.
CHECK_RESOLUTION = 128  # of the isosurface that an intersection is checked against
MAX_KEPT_RESOLUTION = 512  # up to which the height tables of the last surface are kept: a few megabytes


class RoughSurface(NamedTuple):
    """mesh: None where the solid is too thin for it. diagonal: of the solid's box, normalised units."""

    mesh: TriangleMesh | None
    diagonal: float


class DhfSolid:
    """The solid of one file, with tables that are made once. May be used from several threads at once."""

    def __init__(self, records: Sequence[DhfRecord]) -> None:
        self.dhfs = [Dhf(record) for record in records]
        self._cells: CellGrid | None = None
        self._grid_tables: tuple[int, GridTables] | None = None  # with their resolution
        self._thickness: tuple[Thickness | None] | None = None  # None until it is measured
        self._lock = threading.Lock()

    @property
    def has_cells(self) -> bool:
        """Whether the cells have been made."""
        return self._cells is not None

    def cells(self) -> CellGrid:
        """The cells for queries of many points and for rays, made on the first call."""
        from . import cells

        with self._lock:  # the first thread makes them, others wait
            if self._cells is None:
                self._cells = cells.CellGrid(self.dhfs)
            return self._cells

    def isosurface(self, resolution: int, limits: Limits) -> TriangleMesh:
        """The surface by marching cubes. Raises SurfaceError."""
        from . import isosurface

        return isosurface.isosurface(self.dhfs, self._tabulated(resolution), limits)

    def occupancy(self, resolution: int, limits: Limits) -> OccupancyGrid:
        """In/out at the nodes of a grid around the solid. Raises SurfaceError."""
        from . import isosurface

        return isosurface.occupancy(self.dhfs, self._tabulated(resolution), limits)

    def rough_surface(self, limits: Limits) -> RoughSurface:
        """A coarse isosurface, to check an intersection against. Raises SurfaceError for an empty solid."""
        try:
            mesh = self.isosurface(CHECK_RESOLUTION, limits)
            sides = np.ptp(mesh.vertices, axis=0)
        except SurfaceError:  # nothing as thick as a cell
            mesh = None
            grid = self._tabulated(CHECK_RESOLUTION).grid
            sides = grid.spacing * (np.array(grid.shape) - 3)
        return RoughSurface(mesh, float(np.linalg.norm(sides)))

    def intersection(self, error: float, rough: RoughSurface, limits: Limits) -> TriangleMesh:
        """The surface by intersection of the double height fields, each triangulated.

        error: greatest distance from the exact surface, normalised units. Raises SurfaceError when it fails, or when
        its volume differs too much from that of the rough surface.
        """
        from . import intersection

        found = intersection.intersection(self.dhfs, error, limits)
        if rough.mesh is not None:
            # On average, the rough surface is off by half a cell at most, and the intersection by its error.
            volume = intersection.volume(rough.mesh)
            allowed = intersection.area(rough.mesh) * (rough.diagonal / CHECK_RESOLUTION / 2 + error)
            if abs(intersection.volume(found) - volume) > allowed:
                raise SurfaceError("its volume is not that of the solid")
        return found

    def thickness(self) -> Thickness | None:
        """How thick the solid is; None where that is not known."""
        from .thickness import thickness

        with self._lock:
            if self._thickness is None:
                self._thickness = (thickness(self.dhfs),)
            return self._thickness[0]

    def thinner_than_a_cell(self, resolution: int) -> Thickness | None:
        """The solid's thickness, where a cell of this resolution is thicker; else None."""
        found = self.thickness()
        return found if found is not None and found.resolution > resolution else None

    def _tabulated(self, resolution: int) -> GridTables:
        """The grid of a resolution and its height tables. Those of the last one are kept for the next call."""
        from . import isosurface

        with self._lock:
            if self._grid_tables is None or self._grid_tables[0] != resolution:
                made = resolution, isosurface.make_grid(self.dhfs, resolution)
                if resolution > MAX_KEPT_RESOLUTION:
                    return made[1]
                self._grid_tables = made
            return self._grid_tables[1]
