"""Select axes: find which directions see which triangles, and choose among them greedily.

Source: CN-DHF (Hedlin, Yang, Vining, Yi, Sheffer), the section on axis selection.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ...arrays import F32, F64, I64, Mask
from ...mesh.sampling import fibonacci_sphere, points_in
from ...mesh.solid import Solid
from .settings import PaperSettings

N_FIBONACCI = 50
SAMPLES_PER_TRIANGLE = 5
GRAZING = 1e-4  # a ray lies within its face below this cosine between it and the face's normal
SURFACE_OFFSET = 1e-5  # a ray starts this far from the surface it leaves (normalised units)


@dataclass(frozen=True, eq=False)
class AxisChoice:
    """The chosen axes. axes: (K, 3) unit vectors in order of choice. covered: (K,) share of the whole area that the
    first k see. visible: share of the whole area that any candidate sees."""

    axes: F64
    covered: F64
    visible: float


def candidates() -> F64:
    """(53, 3): 50 spherical Fibonacci directions and the three coordinate axes.

    The lattice turns by the golden angle from point to point, the other way round than `fibonacci_sphere`: the paper
    does not say which, and only this one has axes on which its figures for fertility can be (ADR 034).
    """
    return np.concatenate([fibonacci_sphere(N_FIBONACCI) * [1, -1, 1], np.eye(3)])


def visibility(solid: Solid, directions: F64, seed: int, threads: int) -> Mask:
    """(directions, M): whether a double height field along each direction sees each whole triangle.

    There are 5 M samples: ceil(area share) in each triangle, one of them the centroid, the others uniform. A sample is
    occluded when the rays along the direction and against it both hit another triangle. A triangle with any occluded
    sample is occluded.
    """
    owner, points = _samples(solid, seed)
    with ThreadPoolExecutor(threads) as pool:
        rows = list(pool.map(lambda d: _visible_along(solid, d, owner, points), directions))
    return np.stack(rows)


def effective_area(areas: F64, seen: Mask, rarity: str) -> F64:
    """(M,) area weighted by how many candidates see the triangle; 0 where none does.

    rarity "printed": area max(n / mean(n), 1), the paper's formula. "inverse": area max(mean(n) / n, 1), what its text
    says. n is the number of candidates that see the triangle; the mean is over the triangles that any sees.
    """
    n = seen.sum(axis=0).astype(np.float64)
    visible = n > 0
    if not visible.any():
        return np.zeros_like(areas)
    ratio = n / n[visible].mean()
    ratio[~visible] = 1
    return np.where(visible, areas * np.maximum(ratio if rarity == "printed" else 1 / ratio, 1), 0)


def choose_axes(solid: Solid, settings: PaperSettings, seed: int, threads: int) -> AxisChoice:
    """Choose greedily the axis that sees most of the effective area left, until `settings.coverage` of it is seen."""
    directions = candidates()
    seen = visibility(solid, directions, seed, threads)
    weight = effective_area(solid.areas, seen, settings.rarity)
    left = weight.copy()
    chosen: list[int] = []
    covered: list[float] = []
    unseen = np.ones(len(weight), dtype=bool)
    while len(chosen) < (settings.max_axes or len(directions)):
        best = int(np.argmax(seen @ left))
        chosen.append(best)
        unseen &= ~seen[best]
        left[seen[best]] = 0
        covered.append(float(1 - solid.areas[unseen].sum() / solid.areas.sum()))
        if left.sum() <= (1 - settings.coverage) * weight.sum():
            break
    visible = float(solid.areas[seen.any(axis=0)].sum() / solid.areas.sum())
    return AxisChoice(directions[chosen], np.array(covered), visible)


def _samples(solid: Solid, seed: int) -> tuple[I64, F32]:
    """Owner triangle (S,) and position (S, 3) of every sample; the first M are the centroids, in order."""
    m = len(solid.faces)
    counts = np.ceil(SAMPLES_PER_TRIANGLE * m * solid.areas / solid.areas.sum()).astype(np.int64)
    extra = np.repeat(np.arange(m), np.maximum(counts - 1, 0))
    corners = solid.vertices[solid.faces]
    centroids = corners.mean(axis=1)
    others = points_in(corners[extra], np.random.default_rng(seed))
    return (
        np.concatenate([np.arange(m), extra]),
        np.concatenate([centroids, others]).astype(np.float32),
    )


def _visible_along(
    solid: Solid,
    direction: F64,
    owner: I64,
    points: F32,
) -> Mask:
    # The ray on the side that the face looks to is more likely to be free, so it goes first. Samples of triangles that
    # are already occluded are skipped.
    m = len(solid.faces)
    side = np.where(solid.normals @ direction >= 0, 1, -1).astype(np.float32)
    visible = np.ones(m, dtype=bool)
    for part in (slice(0, m), slice(m, None)):
        who, at = owner[part], points[part]
        alive = visible[who]
        who, at = who[alive], at[alive]
        first = _hits_another(solid, at, side[who, None] * direction, who)
        who, at = who[first], at[first]
        second = _hits_another(solid, at, -side[who, None] * direction, who)
        visible[who[second]] = False
    return visible


def _hits_another(solid: Solid, points: F32, directions: np.ndarray, owner: I64) -> Mask:
    """Whether rays from points on the surface hit a triangle other than the one they start on."""
    d = directions.astype(np.float32)
    # A ray within the plane of its face would graze the faces beside it: it starts off the surface.
    normals = solid.normals[owner].astype(np.float32)
    grazing = np.abs((normals * d).sum(axis=1)) < GRAZING
    points = points + np.where(grazing[:, None], SURFACE_OFFSET * normals, 0)
    hit = solid.first_hits(points + SURFACE_OFFSET * d, d)
    # A ray that grazes its own triangle can hit it again in float32: such rays start farther away.
    own = np.flatnonzero(hit == owner)
    if len(own):
        hit[own] = solid.first_hits(points[own] + 100 * SURFACE_OFFSET * d[own], d[own])
    return (hit >= 0) & (hit != owner)
