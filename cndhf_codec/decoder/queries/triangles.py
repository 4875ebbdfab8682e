"""Queries of a triangle mesh: in or out, distances, nearest points and rays."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from ...arrays import F64, I64, Mask
from ..parallel import over_rows
from ..results import NearestPoints, RayHits

if TYPE_CHECKING:
    from .cells import CellGrid
    from .tree import BoxTree

# Points of a piece of `contains`: a thread holds about 30 MB then. Half as many take a fifth more time.
POINTS_AT_ONCE = 2**17
NEAREST_AT_ONCE = 2**15  # points or rays of a piece of the others, which hold about 40 MB
FARTHEST = 1e150  # its square is finite


class TriangleQueries:
    """A triangle mesh, for queries of points and rays in its own coordinates.

    Tables are made by the first query that needs them; a mesh may be queried from several threads at once. `contains`
    and `distance` need a closed mesh, oriented one way: every edge belongs to as many triangles in one direction as in
    the other. Parts may overlap and lie in each other. For an open mesh their answers mean nothing, while `nearest` and
    `ray_intersect` are right for any triangles.

    Parameters
    ----------
    vertices : ndarray of float64, shape (N, 3)
        Positions, all finite.
    faces : ndarray of int, shape (M, 3)
        Numbers of vertices, anticlockwise seen from outside. Triangles without area do no harm.

    Notes
    -----
    Besides the mesh, `contains` keeps up to 12 MB, and 80 bytes per pair of a triangle and a cell that it meets: 29 MB
    for 50,000 triangles. A triangle smaller than a cell meets 8 at most; larger ones together some 2 million. The other
    queries keep 360 bytes per triangle.
    """

    def __init__(self, vertices: F64, faces: I64) -> None:
        self._vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._cells: CellGrid | None = None
        self._tree: BoxTree | None = None
        self._lock = threading.Lock()

    def contains(self, points: F64) -> Mask:
        """Whether points lie inside the mesh: where its winding number is positive.

        Parts that overlap are united. A part inside another is a cavity when it is oriented the other way round, and
        nothing when it is not. A part that is inside out, by itself, holds nothing.

        Parameters
        ----------
        points : ndarray of float32 or float64, shape (N, 3)
            Points. One that is not finite is outside.

        Returns
        -------
        ndarray of bool, shape (N,)
            Exact but for points that are on the surface up to the rounding of float64, where it is either.
        """
        out = np.zeros(len(points), dtype=bool)
        if not len(self._faces):
            return out
        cells = self._grid()
        cells.expect(len(points))

        def work(first: int, last: int) -> None:
            out[first:last] = cells.contains(points[first:last].astype(np.float64, copy=False))

        over_rows(work, len(points), POINTS_AT_ONCE)
        return out

    def nearest(self, points: F64) -> NearestPoints:
        """The point of the mesh that is nearest to each point.

        Parameters
        ----------
        points : ndarray of float32 or float64, shape (N, 3)
            Points.

        Returns
        -------
        NearestPoints
            Exact up to the rounding of float64. For a point that is not finite or beyond 1e150, or a mesh without
            faces, the distance is inf, the face -1 and the point NaN; with a NaN, the distance is NaN.
        """
        distance = np.where(np.isnan(points).any(axis=1), np.nan, np.inf)
        face, point = np.full(len(points), -1), np.full((len(points), 3), np.nan)
        if len(self._faces):
            tree = self._box_tree()
            near = np.flatnonzero(np.abs(points).max(axis=1, initial=0) < FARTHEST)  # NaN is not

            def work(first: int, last: int) -> None:
                part = near[first:last]
                distance[part], face[part], point[part] = tree.nearest(points[part].astype(np.float64, copy=False))

            over_rows(work, len(near), NEAREST_AT_ONCE)
        return NearestPoints(distance, face, point)

    def distance(self, points: F64) -> F64:
        """Signed distance from the mesh: positive inside, as `contains` says, and negative outside.

        Parameters
        ----------
        points : ndarray of float32 or float64, shape (N, 3)
            Points.

        Returns
        -------
        ndarray of float64, shape (N,)
            Distance from the nearest triangle, exact up to the rounding of float64; where parts overlap, that may be
            one inside the solid. -inf and NaN where `nearest` gives inf and NaN.
        """
        distance = self.nearest(points).distance
        return np.negative(distance, out=distance, where=~self.contains(points))

    def ray_intersect(self, origins: F64, directions: F64) -> RayHits:
        """Where rays first hit a triangle, from either side.

        Parameters
        ----------
        origins, directions : ndarray of float32 or float64, shape (N, 3)
            Directions may have any length but zero.

        Returns
        -------
        RayHits
            The distance is inf, and the rest NaN, where a ray misses, has a number that is not finite, or has no
            direction. A ray that starts on the surface may hit there. The normal is the triangle's, by its orientation.
        """
        n = len(origins)
        distance = np.full(n, np.inf)
        point, normal = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        if len(self._faces):
            tree = self._box_tree()
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                d = directions.astype(np.float64, copy=False)
                d = d / np.abs(d).max(axis=1, keepdims=True)  # else its square may overflow or vanish
                d /= np.linalg.norm(d, axis=1, keepdims=True)
            o = origins.astype(np.float64, copy=False)
            valid = np.flatnonzero(np.isfinite(d).all(axis=1) & np.isfinite(o).all(axis=1))

            def work(first: int, last: int) -> None:
                part = valid[first:last]
                distance[part], point[part], normal[part] = tree.first_hits(o[part], d[part])

            over_rows(work, len(valid), NEAREST_AT_ONCE)
        return RayHits(distance, point, normal)

    def _grid(self) -> CellGrid:
        from .cells import CellGrid

        with self._lock:  # the first thread makes it, others wait
            if self._cells is None:
                self._cells = CellGrid(self._vertices, self._faces)
            return self._cells

    def _box_tree(self) -> BoxTree:
        from .tree import BoxTree

        with self._lock:
            if self._tree is None:
                self._tree = BoxTree(self._vertices, self._faces)
            return self._tree
