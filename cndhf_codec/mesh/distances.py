"""Distances between two surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import F64, I64
from ..errors import require
from .sampling import sample_surface

Measure = Callable[[F64, F64, I64], F64]  # distances (N,) of points (N, 3) to a surface's vertices and faces
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
    measure: Measure | None = None,
) -> Distances:
    """Measure exact point-to-triangle distances from area-uniform samples of each surface to the other. measure: in
    place of `point_distances`."""
    measure = point_distances if measure is None else measure
    a_to_b = measure(sample_surface(vertices_a, faces_a, samples, seed), vertices_b, faces_b)
    b_to_a = measure(sample_surface(vertices_b, faces_b, samples, seed), vertices_a, faces_a)
    both = np.concatenate([a_to_b, b_to_a])
    return Distances(float(a_to_b.mean() + b_to_a.mean()) / 2, float(np.percentile(both, 99)), float(both.max()))


def point_distances(points: F64, vertices: F64, faces: I64) -> F64:
    """(N,) exact distance of points (N, 3) to a surface, in the units of their coordinates."""
    igl: Any = require("igl", "compare")
    return np.sqrt(igl.point_mesh_squared_distance(points, np.ascontiguousarray(vertices), faces)[0])
