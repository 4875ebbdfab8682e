"""Verification: what the bytes just written decode to, measured against the input mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import require

SAMPLES = 200_000  # area-uniform points on each of the two surfaces


@dataclass(frozen=True)
class Distances:
    """Distances between two surfaces, in the units of their coordinates.

    chamfer: mean of the two directed mean point-to-surface distances. p99, maximum: over the samples of
    both directions; the maximum estimates the Hausdorff distance from below.
    """

    chamfer: float
    p99: float
    maximum: float

    def scaled(self, factor: float) -> Distances:
        return Distances(self.chamfer * factor, self.p99 * factor, self.maximum * factor)


def surface_distances(
    vertices_a: npt.NDArray[np.float64],
    faces_a: npt.NDArray[np.int64],
    vertices_b: npt.NDArray[np.float64],
    faces_b: npt.NDArray[np.int64],
    seed: int = 0,
    samples: int = SAMPLES,
) -> Distances:
    """Exact point-to-triangle distances from area-uniform samples of each surface to the other."""
    a_to_b = _directed(vertices_a, faces_a, vertices_b, faces_b, seed, samples)
    b_to_a = _directed(vertices_b, faces_b, vertices_a, faces_a, seed, samples)
    both = np.concatenate([a_to_b, b_to_a])
    return Distances(float(a_to_b.mean() + b_to_a.mean()) / 2, float(np.percentile(both, 99)), float(both.max()))


def point_distances(
    points: npt.NDArray[np.float64], vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    """(N,) exact distance of points (N, 3) to a surface, in the units of their coordinates."""
    igl: Any = require("igl", "encode")
    return np.sqrt(igl.point_mesh_squared_distance(points, np.ascontiguousarray(vertices), faces)[0])


def sample_surface(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], n: int, seed: int
) -> npt.NDArray[np.float64]:
    """(n, 3) points drawn uniformly by area."""
    trimesh: Any = require("trimesh", "encode")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, n, seed=seed)[0])


def _directed(
    vertices_from: npt.NDArray[np.float64],
    faces_from: npt.NDArray[np.int64],
    vertices_to: npt.NDArray[np.float64],
    faces_to: npt.NDArray[np.int64],
    seed: int,
    samples: int,
) -> npt.NDArray[np.float64]:
    return point_distances(sample_surface(vertices_from, faces_from, samples, seed), vertices_to, faces_to)
