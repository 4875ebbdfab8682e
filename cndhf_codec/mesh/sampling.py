"""Draw uniform samples: points of triangles by area, and directions of the sphere."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import F64, I64

GOLDEN = (math.sqrt(5) - 1) / 2


def area_normals(vertices: F64, faces: I64) -> F64:
    """(M, 3) normals of faces, with twice their areas as lengths."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def face_areas(vertices: F64, faces: I64) -> F64:
    """(M,) areas of faces."""
    return np.asarray(np.linalg.norm(area_normals(vertices, faces), axis=1)) / 2


def draw_faces(areas: F64, count: int, rng: np.random.Generator) -> I64:
    """Draw faces, (count,), with probabilities proportional to their areas. They are in ascending order, so that points
    of neighbouring faces are neighbours in memory."""
    cumulative = np.cumsum(areas)
    face = np.sort(np.searchsorted(cumulative, rng.random(count) * cumulative[-1]))
    return np.minimum(face, len(cumulative) - 1)


def points_in(corners: F64, rng: np.random.Generator) -> F64:
    """Draw a point in each triangle (N, 3, 3), uniform by area: (N, 3).

    Barycentric coordinates 1 - sqrt(a), sqrt(a) (1 - b), sqrt(a) b for uniform a, b: Osada et al., "Shape
    Distributions" (2002).
    """
    r1, r2 = np.sqrt(rng.random(len(corners))), rng.random(len(corners))
    weights = np.column_stack([1 - r1, r1 * (1 - r2), r1 * r2])
    return np.asarray(np.einsum("nk,nkd->nd", weights, corners))


def cover_evenly(vertices: F64, faces: I64, count: int) -> tuple[I64, F64]:
    """Points that cover a surface evenly: faces (count,), ascending, and barycentric places (count, 3) in them.

    Equal steps along the running sum of areas choose the face and one coordinate; multiples of the golden ratio the
    other, which spread evenly (Weyl, 1916). Where faces that follow each other are neighbours, all parts of the surface
    have their share of the points, while independent ones leave gaps.
    """
    along = np.cumsum(face_areas(vertices, faces))
    wanted = (np.arange(count) + 0.5) / count * along[-1]
    at = np.minimum(np.searchsorted(along, wanted), len(faces) - 1)
    before = np.where(at > 0, along[at - 1], 0.0)
    root = np.sqrt(np.clip((wanted - before) / np.maximum(along[at] - before, 1e-300), 0, 1))
    other = np.arange(count) * GOLDEN % 1
    return at, np.column_stack([1 - root, root * (1 - other), root * other])


def sample_surface(vertices: F64, faces: I64, count: int, seed: int) -> F64:
    """Draw points of a surface, (count, 3), uniform by area."""
    rng = np.random.default_rng(seed)
    return points_in(vertices[faces[draw_faces(face_areas(vertices, faces), count, rng)]], rng)


def fibonacci_sphere(n: int) -> F64:
    """(n, 3) unit vectors on the spherical Fibonacci lattice, as in Keinert et al., "Spherical Fibonacci
    Mapping" (2015): longitude 2 pi i / golden ratio, z = 1 - (2 i + 1) / n."""
    i = np.arange(n)
    z = 1 - (2 * i + 1) / n
    phi = 2 * np.pi * (i * GOLDEN % 1)
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])
