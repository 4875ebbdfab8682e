"""Distances between two surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import F64, I64
from ..errors import require
from .sampling import sample_surface

SAMPLES_PER_SURFACE = 200_000  # area-uniform points on each of the two surfaces


@dataclass(frozen=True)
class Distances:
    """Distances between two surfaces, in the units of their coordinates.

    mean: the mean error (CD), the mean of the two directed mean point-to-surface distances. p99, maximum: over the
    samples of both directions; the maximum estimates the Hausdorff distance from below.
    """

    mean: float
    p99: float
    maximum: float

    def scaled(self, factor: float) -> Distances:
        return Distances(self.mean * factor, self.p99 * factor, self.maximum * factor)


def surface_distances(
    vertices_a: F64,
    faces_a: I64,
    vertices_b: F64,
    faces_b: I64,
    seed: int = 0,
    samples: int = SAMPLES_PER_SURFACE,
) -> Distances:
    """Measure exact point-to-triangle distances from area-uniform samples of each surface to the other."""
    a_to_b = _directed(vertices_a, faces_a, vertices_b, faces_b, seed, samples)
    b_to_a = _directed(vertices_b, faces_b, vertices_a, faces_a, seed, samples)
    both = np.concatenate([a_to_b, b_to_a])
    return Distances(float(a_to_b.mean() + b_to_a.mean()) / 2, float(np.percentile(both, 99)), float(both.max()))


def point_distances(points: F64, vertices: F64, faces: I64) -> F64:
    """(N,) exact distance of points (N, 3) to a surface, in the units of their coordinates."""
    igl: Any = require("igl", "compare")
    return np.sqrt(igl.point_mesh_squared_distance(points, np.ascontiguousarray(vertices), faces)[0])


def _directed(
    vertices_from: F64,
    faces_from: I64,
    vertices_to: F64,
    faces_to: I64,
    seed: int,
    samples: int,
) -> F64:
    return point_distances(sample_surface(vertices_from, faces_from, samples, seed), vertices_to, faces_to)
