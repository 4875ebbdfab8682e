"""Draw samples of the solid for the joint fit: points of its surface and points of space.

The truth about a point is that of the exact height fields' intersection, which is all that the chosen fields can
represent. So a point of a hidden cavity counts as inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....arrays import F32, F64, Mask
from ....errors import require
from ....mesh.solid import Solid
from ..frames import Frame

# Evidence for these constants: ADR 015; CLEARANCE: 018; OTHER_SIDE: 016.
#
# Shares of the uniform space samples that are moved to a wall or a side, and their greatest distance from it
# (normalised units).
WALL_SHARE, WALL_DEPTH = 0.25, 0.01  # just inside the walls of the domain boxes
SHELL_SHARE, SHELL_DEPTH = 0.15, 0.05  # just outside the input's bounding box
SURFACE_SPREADS = (0.01, 0.04)  # standard deviations of the offsets of space samples near the surface
CLEARANCE = 0.02  # least distance from the surface of a counterexample
OTHER_SIDE = 0.1  # greatest distance at which the nearest point of the other side counts


class OppositeSamples:
    """Space samples on the two sides of the exact height fields' surface.

    Where the fields fill what no axis sees, that surface is far from every face. The distance from it is then about
    that from the nearest sample on the other side.
    """

    def __init__(self, space: F32 | F64, excluded: Mask) -> None:
        """space: (M, 3). excluded: (M, K) whether field k excludes the point."""
        outside = excluded.any(axis=1)
        spatial = require("scipy.spatial", "encode")
        self._others = [(side, spatial.KDTree(space[outside != side])) for side in (False, True)]

    def nearer(
        self,
        points: F32 | F64,
        excluded: Mask,
        distance: F64,
    ) -> F64:
        """(N,) distance of points (N, 3) from the faces (`distance`), or, if less, from the nearest sample on the other
        side."""
        outside, least = excluded.any(axis=1), distance.copy()
        for side, others in self._others:
            at = np.flatnonzero(outside == side)
            least[at] = np.minimum(least[at], others.query(points[at], distance_upper_bound=OTHER_SIDE)[0])
        return least


@dataclass(frozen=True, eq=False)
class Samples:
    """N surface samples, each seen by some field, and M space samples; normalised frame.

    surface: (N, 3) float32. seen: (N, K) whether field k sees the point. cosine: (N, K) float32 |normal . axis|.
    space: (M, 3) float32. excluded: (M, K) whether field k's exact heights leave the point out; a point is inside when
    no field excludes it. distance: (M,) float32 from the surface. sides: of the space samples. box: (2, 3) bounding box
    of the solid.
    """

    surface: F32
    seen: Mask
    cosine: F32
    space: F32
    excluded: Mask
    distance: F32
    sides: OppositeSamples
    box: F32

    def in_random_order(self, rng: np.random.Generator) -> Samples:
        on, off = rng.permutation(len(self.surface)), rng.permutation(len(self.space))
        return Samples(
            self.surface[on],
            self.seen[on],
            self.cosine[on],
            self.space[off],
            self.excluded[off],
            self.distance[off],
            self.sides,
            self.box,
        )


def draw_samples(solid: Solid, frames: list[Frame], count: int, seed: int) -> Samples:
    """Draw `count` points of the surface, uniform by area, and as many of space. Half of the latter are near the
    surface, half uniform in the intersection of the domain boxes, which is all the space that the fields can fill."""
    rng = np.random.default_rng(seed)
    axes = np.stack([f.rotation[2] for f in frames])
    points, normals = solid.sample(count, rng)
    seen = np.stack([solid.visible_along(a, points, normals) for a in axes], axis=1)
    keep = seen.any(axis=1)

    half = count // 2
    spread = np.asarray(SURFACE_SPREADS)[np.arange(half) % len(SURFACE_SPREADS)]
    around = points[rng.integers(len(points), size=half)] + rng.normal(size=(half, 3)) * spread[:, None]
    box = np.stack([solid.vertices.min(axis=0), solid.vertices.max(axis=0)])
    uniform = _at_walls(_in_boxes(frames, count - half, rng), frames, rng)
    space = np.concatenate([around, _at_shell(uniform, box, rng)])
    space = space[np.lexsort((np.floor(space[:, 2] * 16), np.floor(space[:, 1] * 16), np.floor(space[:, 0] * 16)))]
    excluded = excluded_points(solid, frames, space)
    sides = OppositeSamples(space, excluded)
    return Samples(
        surface=points[keep].astype(np.float32),
        seen=seen[keep],
        cosine=np.abs(normals[keep] @ axes.T).astype(np.float32),
        space=space.astype(np.float32),
        excluded=excluded,
        distance=sides.nearer(space, excluded, solid.distances(space)).astype(np.float32),
        sides=sides,
        box=box.astype(np.float32),
    )


def excluded_points(solid: Solid, frames: list[Frame], points: F64) -> Mask:
    """(N, K): whether the exact heights of each field exclude points (N, 3)."""
    axes = [f.rotation[2] for f in frames]
    excluded = np.stack([(solid.first_hits(points, a) < 0) | (solid.first_hits(points, -a) < 0) for a in axes], axis=1)
    # A ray may leave the solid through a hole of the mesh, so points inside by winding number are not excluded.
    doubtful = np.flatnonzero(excluded.any(axis=1))
    excluded[doubtful[solid.contains(points[doubtful])]] = False
    return excluded


def in_box(frame: Frame, points: F64) -> Mask:
    """(N,) whether points (N, 3) are in the frame's domain box."""
    inside = np.ones(len(points), dtype=bool)
    for x, (lo, hi) in zip((points @ frame.rotation.T).T, frame.bounds, strict=True):
        inside &= (x >= lo) & (x <= hi)
    return inside


def _in_boxes(frames: list[Frame], count: int, rng: np.random.Generator) -> F64:
    lo, hi = frames[0].bounds.T
    parts: list[F64] = []
    while sum(map(len, parts)) < count:
        p = (lo + rng.random((count, 3)) * (hi - lo)) @ frames[0].rotation
        for f in frames[1:]:
            p = p[in_box(f, p)]
        parts.append(p)
    return np.concatenate(parts)[:count]


def _at_walls(points: F64, frames: list[Frame], rng: np.random.Generator) -> F64:
    """Move a share of the points, in place, to just inside a wall of a domain box: slivers of solid often stand there,
    and few uniform points are near."""
    count = round(len(points) * WALL_SHARE)
    walls = [(f, axis, side) for f in frames for axis in range(3) for side in range(2)]
    for (f, axis, side), part in zip(walls, np.array_split(np.arange(count), len(walls)), strict=True):
        uvz = points[part] @ f.rotation.T
        uvz[:, axis] = f.bounds[axis, side] + (1 - 2 * side) * rng.random(len(part)) * WALL_DEPTH
        points[part] = uvz @ f.rotation
    return points


def _at_shell(points: F64, box: F64, rng: np.random.Generator) -> F64:
    """Move a share of the points, in place, to just outside the bounding box: solid that juts out there changes it."""
    chosen = rng.choice(len(points), round(len(points) * SHELL_SHARE), replace=False)
    axis, side = rng.integers(3, size=len(chosen)), rng.integers(2, size=len(chosen))
    points[chosen, axis] = box[side, axis] + (2 * side - 1) * rng.random(len(chosen)) * SHELL_DEPTH
    return points
