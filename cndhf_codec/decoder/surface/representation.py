"""The representation `surface`: the limit of a control mesh, as `Model` asks for it.

A mesh is a level of subdivision, with all vertices on the limit surface; the default mesh, which answers queries, has
triangles of several levels (adaptive.py). To a number of triangles, either is simplified.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from ...arguments import length, whole_in
from ...arrays import F32, F64, I64, Mask
from ...errors import OptionError, SheetError, SurfaceError
from ...format import Container
from ..file_error import measured_errors
from ..limits import MIN_RESOLUTION, Limits
from ..pieces import piece_labels
from ..queries import TriangleQueries
from ..representation import Detail
from ..results import NearestPoints, OccupancyGrid, RayHits, ShadedMesh, TriangleMesh
from ..simplify import LEAST_FACES, with_faces
from .adaptive import adaptive_corners, balanced
from .levels import MAX_LEVEL, Distances, Level, next_level, size_at
from .normals import limit_normals, sectors_of, with_normals
from .subdivision import Topology, topology_of

# Evidence for these constants: ADR 038.
TOLERANCE = 0.5  # times the file's mean error: how far an edge of a default mesh may be from the surface
UNKNOWN_ERROR = "0.02%"  # of the diagonal: in its place where the file says nothing of its error
# So many edges of the finest level need not keep to it: where many faces meet, and where the surface bends most, they
# are ten times as far off as on average.
BEYOND = 0.1
SPARE = 2 / 3  # where a tolerance is to be kept everywhere, an estimate of the error has to be so much of it
# The most triangles of the finest level of a default mesh, and so of the mesh: 2 seconds. Only a file of 16 kB has so
# many at a level that is not fine enough, and there they are small.
MOST_FACES = 2**19
ON_SURFACE = 1e-9  # normalised units: nearer, the direction from the nearest point is rounding


class SurfaceRepresentation:
    """See `decoder.representation.Representation`."""

    kind: Final = "surface"
    points_at_once = 2**17

    def __init__(self, container: Container) -> None:
        assert container.surface is not None
        self._control, self._scale = container.surface, container.scale
        self._errors = measured_errors(container)
        self._mesh: _QueriedMesh | None = None
        self._lock = threading.Lock()

    @cached_property
    def topology(self) -> Topology:
        """Faces and edges of the control mesh."""
        return topology_of(self._control.faces, len(self._control.positions), self._control.sharp)

    @cached_property
    def closed(self) -> bool:
        """Whether every edge has two faces."""
        return bool((np.bincount(self.topology.face_edges.ravel()) == 2).all())

    @cached_property
    def oriented(self) -> bool:
        """Whether neighbouring faces agree in orientation."""
        mesh = self.topology
        directed = 2 * mesh.face_edges + (mesh.edges[mesh.face_edges, 0] != mesh.faces)
        return bool(np.bincount(directed.ravel()).max(initial=1) == 1)

    def describe(self, size: int) -> dict[str, Any]:
        return {
            "vertices": len(self._control.positions),
            "faces": len(self._control.faces),
            "sharp_edges": len(self._control.sharp),
            "components": int(piece_labels(self.topology.faces, len(self._control.positions)).max(initial=-1)) + 1,
            "closed": self.closed,
            "bits_per_vertex": 8 * size / max(len(self._control.positions), 1),
        }

    def prepare(self, n_points: int) -> None:
        self._need_inside()

    def contains(self, points: F64) -> Mask:
        self._need_inside()
        return self._queried().queries.contains(points)

    def implicit(self, points: F64) -> F32:
        with np.errstate(over="ignore"):
            return self.distance(points).astype(np.float32)

    def implicit_gradient(self, points: F64) -> tuple[F32, F32]:
        self._need_inside()
        mesh = self._queried()
        near = mesh.queries.nearest(points)
        inside = mesh.queries.contains(points)
        sign = np.where(inside, 1.0, -1.0)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            slope = sign[:, None] * (points - near.point) / near.distance[:, None]
            # On the surface the direction is that of the normal; where there is no nearest point, there is none.
            close = near.distance <= ON_SURFACE
            slope[close] = -mesh.normals_at(near.face[close], near.point[close])
            slope[near.face < 0] = 0
            return (sign * near.distance).astype(np.float32), slope.astype(np.float32)

    def distance(self, points: F64) -> F64:
        self._need_inside()
        return self._queried().queries.distance(points)

    def nearest(self, points: F64) -> NearestPoints:
        return self._queried().queries.nearest(points)

    def normals(self, points: F64) -> F32:
        return self._queried().normals_at_nearest(points).astype(np.float32)

    def first_hits(self, origins: F64, directions: F64) -> RayHits:
        return self._queried().queries.ray_intersect(origins, directions)

    def mesh(self, detail: Detail, limits: Limits) -> TriangleMesh:
        return _reduced(self._chosen(detail, limits), detail.faces)

    def shaded_mesh(self, detail: Detail, limits: Limits) -> ShadedMesh:
        chosen = self._chosen(detail, limits)
        mesh = _reduced(chosen, detail.faces)
        if len(mesh.faces) == len(chosen.corners):
            return chosen.shaded()
        return with_normals(mesh, _QueriedMesh(chosen.plain(), chosen.shaded).normals_at_nearest)

    def occupancy(self, resolution: int, limits: Limits) -> OccupancyGrid:
        resolution = whole_in(resolution, "resolution", MIN_RESOLUTION, limits.resolution)
        self._need_inside()
        vertices = self._queried().vertices
        lo, hi = vertices.min(axis=0), vertices.max(axis=0)
        # Half a cell less, so that no node falls on planes that bound the solid.
        spacing = float((hi - lo).max()) / (resolution - 0.5)
        if not spacing > 0:
            raise SurfaceError("the surface is a point; there is nothing to make a grid of")
        shape = np.ceil((hi - lo) / spacing).astype(int) + 3
        limits.count("nodes", int(np.prod(shape.astype(float))))
        origin = (lo + hi) / 2 - (shape - 1) / 2 * spacing
        nx, ny, nz = (int(n) for n in shape)
        grid = np.zeros((nx, ny, nz), dtype=bool)
        flat = grid.reshape(-1)
        for first in range(0, flat.size, self.points_at_once):
            at = np.unravel_index(np.arange(first, min(first + self.points_at_once, flat.size)), grid.shape)
            flat[first : first + self.points_at_once] = self.contains(origin + spacing * np.column_stack(at))
        return OccupancyGrid(grid, origin, spacing)

    def _need_inside(self) -> None:
        if not self.closed:
            raise SheetError(
                "the file holds a sheet, which has no inside: ask for nearest points, which have distances without a "
                "sign, or encode it with --thicken"
            )
        if not self.oriented:
            raise SheetError(
                "the file holds a surface whose faces disagree in orientation, so it has no inside: ask for nearest "
                "points, which have distances without a sign"
            )

    def _queried(self) -> _QueriedMesh:
        with self._lock:  # the first thread makes it, others wait
            if self._mesh is None:
                self._mesh = _QueriedMesh(self._default(Limits()).plain(), lambda: self._default(Limits()).shaded())
            return self._mesh

    def _chosen(self, detail: Detail, limits: Limits) -> _Chosen:
        """The mesh that was asked for, before it is simplified. Raises OptionError or SurfaceError."""
        if detail.resolution is not None or detail.method is not None or detail.specks:
            raise OptionError(
                "resolution, method and specks belong to double height fields; this file holds a surface: give level, "
                "max_error or faces"
            )
        given = [x for x in (detail.level, detail.max_error, detail.faces) if x is not None]
        if len(given) > 1:
            raise OptionError("give one of level, max_error and faces")
        if detail.level is not None:
            return _Chosen.whole(self._at(whole_in(detail.level, "level", 0, MAX_LEVEL), limits))
        if detail.faces is not None:
            most, own = whole_in(detail.faces, "faces", LEAST_FACES), len(self._control.faces)
            # The default mesh has triangles where they are needed. But rims are kept, and it may have them finer than
            # `faces` allows.
            if self.closed and self.oriented and all(own * 4**k != most for k in range(MAX_LEVEL)):
                with suppress(SurfaceError):  # limits may allow a coarser level alone
                    default = self._default(limits)
                    if len(default.corners) > most:
                        return default
            # From twice as many triangles and more, there is a choice of what to leave out.
            enough = (k for k in range(MAX_LEVEL) if own * 4**k == most or own * 4**k >= 2 * most)
            return _Chosen.whole(self._at(next(enough, MAX_LEVEL), limits))
        if detail.max_error is not None:
            return _Chosen.whole(self._within(detail.max_error, limits))
        return self._default(limits)

    def _at(self, number: int, limits: Limits) -> Level:
        if not len(self._control.faces):
            raise SurfaceError("the surface has no faces")
        vertices, _ = size_at(self.topology, number)
        if vertices > limits.vertices:
            raise SurfaceError(
                f"level {number} has {vertices} vertices; {limits.vertices} are allowed: ask for a lower level, or, "
                "from Python, set model.limits = Limits(vertices=...) if you trust this file"
            )
        level = Level(0, self.topology, self._control.vertices)
        for _ in range(number):
            level = next_level(level)
        return level

    def _within(self, max_error: float | str, limits: Limits) -> Level:
        """The first level that is within an error everywhere."""
        level = self._at(0, limits)
        tolerance = length(max_error, _diagonal(level), self._scale)
        levels, error = self._refined(level, tolerance, lambda distances: distances.greatest, SPARE, MAX_LEVEL, limits)
        if error > tolerance:
            raise self._too_coarse(levels[-1], error)
        return levels[-1]

    def _default(self, limits: Limits) -> _Chosen:
        """The mesh whose triangles are as near to the surface as the file's error asks for."""
        level = self._at(0, limits)
        diagonal = _diagonal(level)
        if self._errors is None:
            tolerance = length(UNKNOWN_ERROR, diagonal, self._scale)
        else:
            tolerance = self._errors.tolerance(TOLERANCE, diagonal)
        few = (k for k in range(MAX_LEVEL, 0, -1) if len(level.topology.faces) * 4**k <= MOST_FACES)
        levels, _ = self._refined(level, tolerance, _most_edges, 1.0, next(few, 0), limits)
        corners = adaptive_corners(levels, tolerance)
        # Where orientation changes, there is no outward.
        return _Chosen(levels[-1], corners, balanced(levels[-1], corners) if self.oriented else levels[-1].limit)

    def _refined(
        self,
        level: Level,
        tolerance: float,
        measure: Callable[[Distances], float],
        believed: float,
        finest: int,
        limits: Limits,
    ) -> tuple[list[Level], float]:
        """Levels from this one on: to the first whose measure is within a tolerance, or to the finest; and the measure
        of the last, or an estimate of it."""
        levels, error, ratio = [level], measure(level.distances), 1.0
        while error > tolerance and level.number < finest:
            if size_at(self.topology, level.number + 1)[0] > limits.vertices:
                raise self._too_coarse(level, error)
            level = next_level(level)
            levels.append(level)
            # A step divides the error by four in the end. To measure it takes longer than to make the level, so when
            # it will do even if it goes on as in the step before, and `believed` of the tolerance is enough, it is.
            estimate = max(ratio, 1 / 4) * error
            if estimate < believed * tolerance:
                return levels, estimate
            before, error = error, measure(level.distances)
            ratio = error / before
        return levels, error

    def _too_coarse(self, level: Level, error: float) -> SurfaceError:
        return SurfaceError(
            f"level {level.number}, the finest one that is allowed, is off by {error * self._scale:.3g}: raise "
            "max_error, or ask for a level"
        )


class _Chosen(NamedTuple):
    """A mesh: the corners (M, 3) of its triangles are corners of a level's faces, 3 f + k corner k of face f; vertices
    (V, 3) has their places."""

    level: Level
    corners: I64
    vertices: F64

    @classmethod
    def whole(cls, level: Level) -> _Chosen:
        """All of a level."""
        return cls(level, np.arange(level.topology.faces.size).reshape(-1, 3), level.limit)

    def plain(self) -> TriangleMesh:
        """A vertex per place."""
        used, faces = _numbered(self.level.topology.faces, self.corners)
        return TriangleMesh(self.vertices[used], faces)

    def shaded(self) -> ShadedMesh:
        """With normals and a vertex per sector, which keeps creases sharp."""
        level = self.level
        sectors = sectors_of(level.topology)
        normals = limit_normals(level.topology, level.vertices, level.limit, sectors)
        used, faces = _numbered(sectors.corners, self.corners)
        return ShadedMesh(self.vertices[sectors.vertices[used]], faces, normals[used])


class _QueriedMesh:
    """A mesh with the tables of its queries, and normals between its vertices."""

    def __init__(self, mesh: TriangleMesh, shaded: Callable[[], ShadedMesh]) -> None:
        """shaded: makes it again, with the same triangles. Most queries need no normals, and the levels that they are
        made of take much more memory than the mesh."""
        self.vertices, faces = mesh
        self.queries = TriangleQueries(self.vertices, faces)
        self._make_shaded = shaded

    @cached_property
    def _shaded(self) -> ShadedMesh:
        return self._make_shaded()

    def normals_at_nearest(self, points: F64) -> F64:
        """(N, 3) unit normals at the nearest points; 0 where there is none."""
        near = self.queries.nearest(points)
        out = np.zeros((len(points), 3))
        found = np.flatnonzero(near.face >= 0)
        out[found] = self.normals_at(near.face[found], near.point[found])
        return out

    def normals_at(self, faces: I64, points: F64) -> F64:
        """(N, 3) unit normals at points of faces (N,), between those of the corners."""
        if not len(faces):
            return np.zeros((0, 3))
        vertices, triangles, normals = self._shaded
        a, b, c = vertices[triangles[faces]].transpose(1, 0, 2)
        whole = np.cross(b - a, c - a)
        shares = [(np.cross(q - p, points - p) * whole).sum(axis=1) for p, q in ((b, c), (c, a), (a, b))]
        corners = normals[triangles[faces]]
        total = (whole * whole).sum(axis=1)
        # A triangle without area has the mean of its corners.
        weights = np.where(total[:, None] > 0, np.column_stack(shares), 1.0)
        normal = (corners * weights[..., None]).sum(axis=1)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.divide(normal, size, out=np.zeros_like(normal), where=size > 0)


def _reduced(chosen: _Chosen, faces: int | None) -> TriangleMesh:
    """The mesh, simplified to so many triangles. Raises OptionError where topology asks for more."""
    mesh = chosen.plain()
    return mesh if faces is None or len(mesh.faces) <= faces else with_faces(mesh, faces)


def _numbered(of_corners: I64, corners: I64) -> tuple[I64, I64]:
    """The numbers that corners (M, 3) have in `of_corners` (F, 3): which occur, rising, and the place of each there."""
    found = of_corners.ravel()[corners]
    used = np.zeros(of_corners.max() + 1, dtype=bool)
    used[found] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[found]


def _most_edges(distances: Distances) -> float:
    """The distance that all edges but `BEYOND` keep to."""
    place = int((1 - BEYOND) * (len(distances.edges) - 1))
    return float(np.partition(distances.edges, place)[place])


def _diagonal(level: Level) -> float:
    return float(np.linalg.norm(np.ptp(level.limit, axis=0)))
