"""What surfaces, grids and rays return: tuples whose parts have names."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import F64, I64, Mask


class TriangleMesh(NamedTuple):
    """A surface in the normalised frame: closed, but that of a sheet.

    Attributes
    ----------
    vertices : ndarray of float64, shape (N, 3)
        Positions.
    faces : ndarray of int64, shape (M, 3)
        Numbers of vertices, anticlockwise seen from outside.
    """

    vertices: F64
    faces: I64


class ShadedMesh(NamedTuple):
    """A surface in the normalised frame with a normal per vertex. A vertex on a sharp edge may come once per side.

    Attributes
    ----------
    vertices : ndarray of float64, shape (N, 3)
        Positions.
    faces : ndarray of int64, shape (M, 3)
        Numbers of vertices, anticlockwise seen from outside.
    normals : ndarray of floats, shape (N, 3)
        Outward, of length one.
    """

    vertices: F64
    faces: I64
    normals: npt.NDArray[np.floating]


class OccupancyGrid(NamedTuple):
    """In/out at the nodes of a regular grid: what `Model.occupancy` returns.

    Attributes
    ----------
    grid : ndarray of bool, shape (nx, ny, nz)
        Whether node (i, j, k), at origin + spacing * (i, j, k), is inside the solid or on its surface.
    origin : ndarray of float64, shape (3,)
        Position of node (0, 0, 0).
    spacing : float
        Distance between neighbouring nodes.
    """

    grid: Mask
    origin: F64
    spacing: float


class NearestPoints(NamedTuple):
    """Nearest points of a triangle mesh.

    Attributes
    ----------
    distance : ndarray of float64, shape (N,)
        Distance from the mesh, at least 0.
    face : ndarray of int64, shape (N,)
        Number of a face with the nearest point; -1 where there is none.
    point : ndarray of float64, shape (N, 3)
        The nearest point; NaN where there is none.
    """

    distance: F64
    face: I64
    point: F64


class Nearest(NamedTuple):
    """Nearest points of the surface: what `Model.nearest` returns. `...` stands for the shape of the points.

    Attributes
    ----------
    distance : ndarray of float64, shape (...)
        Distance in input units, at least 0.
    point : ndarray of float64, shape (..., 3)
        The nearest point, in input coordinates.
    """

    distance: F64
    point: F64


class RayHits(NamedTuple):
    """First crossings of rays with the surface: what `Model.ray_intersect` returns.

    The arrays are float32 when the rays were, else float64. `...` stands for the shape of the rays.

    Attributes
    ----------
    distance : ndarray, shape (...)
        Distance from the ray's origin in input units, at least 0; inf where the ray misses.
    point : ndarray, shape (..., 3)
        Crossing in input coordinates; NaN where the ray misses.
    normal : ndarray, shape (..., 3)
        Outward normal of length one; NaN where the ray misses.

    Examples
    --------
    >>> import cndhf_codec
    >>> model = cndhf_codec.load("tests/golden/encoded.cndhf")
    >>> hits = model.ray_intersect([[20, 10, 100], [20, 80, 100]], [0, 0, -1])
    >>> hits.distance.round(1)
    array([92., inf])
    """

    distance: npt.NDArray[np.floating]
    point: npt.NDArray[np.floating]
    normal: npt.NDArray[np.floating]
