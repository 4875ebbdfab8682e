"""What `Model` asks of a representation: queries, surfaces and grids in the normalised frame."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

from ..arrays import F32, F64, Mask
from .limits import Limits
from .results import NearestPoints, OccupancyGrid, RayHits, ShadedMesh, TriangleMesh

Method = Literal["marching-cubes", "intersection"]


class Detail(NamedTuple):
    """How fine a mesh shall be, as `Model.to_mesh` takes it: None where nothing was said.

    Each representation refuses what belongs to the other.
    """

    resolution: int | None = None
    method: Method | None = None
    max_error: float | str | None = None
    faces: int | None = None
    level: int | None = None
    specks: bool = False


class Representation(Protocol):
    """The shape of one file. Points (N, 3) are float64 and lengths are those of the normalised frame.

    All may be called from several threads at once. Queries are asked for `points_at_once` points or fewer.
    """

    points_at_once: int

    @property
    def kind(self) -> Literal["dhf", "surface"]:
        """As the encoder's option calls it."""
        ...

    def describe(self, size: int) -> dict[str, Any]:
        """What `Model.info` says of the representation alone. size: of the file, in bytes."""
        ...

    def prepare(self, n_points: int) -> None:
        """Expect so many points in calls of `contains`: make the tables that are worth it."""
        ...

    def contains(self, points: F64) -> Mask:
        """(N,) whether points are inside or on the surface. Raises SheetError."""
        ...

    def implicit(self, points: F64) -> F32:
        """(N,) positive inside. Raises SheetError."""
        ...

    def implicit_gradient(self, points: F64) -> tuple[F32, F32]:
        """(N,) the same, and (N, 3) its gradient. Raises SheetError."""
        ...

    def distance(self, points: F64) -> F64:
        """(N,) distance from the surface, positive inside. Raises SheetError."""
        ...

    def nearest(self, points: F64) -> NearestPoints:
        """Nearest points of the surface."""
        ...

    def normals(self, points: F64) -> F32:
        """(N, 3) outward unit normals at points on the surface."""
        ...

    def first_hits(self, origins: F64, directions: F64) -> RayHits:
        """Where rays first cross the surface; directions (N, 3) have any length."""
        ...

    def mesh(self, detail: Detail, limits: Limits) -> TriangleMesh:
        """The surface. Raises OptionError or SurfaceError."""
        ...

    def shaded_mesh(self, detail: Detail, limits: Limits) -> ShadedMesh:
        """The surface with normals. Raises OptionError or SurfaceError."""
        ...

    def occupancy(self, resolution: int, limits: Limits) -> OccupancyGrid:
        """In/out at the nodes of a grid. Raises OptionError, SheetError or SurfaceError."""
        ...
