"""Draw uniform samples: points of triangles by area, and directions of the sphere."""

from __future__ import annotations

import numpy as np

from ..arrays import F64, I64


def face_areas(vertices: F64, faces: I64) -> F64:
    """(M,) areas of faces."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2


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


def sample_surface(vertices: F64, faces: I64, count: int, seed: int) -> F64:
    """Draw points of a surface, (count, 3), uniform by area."""
    rng = np.random.default_rng(seed)
    return points_in(vertices[faces[draw_faces(face_areas(vertices, faces), count, rng)]], rng)


def fibonacci_sphere(n: int) -> F64:
    """(n, 3) unit vectors on the spherical Fibonacci lattice, as in Keinert et al., "Spherical Fibonacci
    Mapping" (2015): longitude 2 pi i / golden ratio, z = 1 - (2 i + 1) / n."""
    i = np.arange(n)
    z = 1 - (2 * i + 1) / n
    phi = 2 * np.pi * (i * (np.sqrt(5) - 1) / 2 % 1)
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])
