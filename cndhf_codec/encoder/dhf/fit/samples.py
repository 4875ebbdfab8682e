"""Samples of the solid in space, for the joint fit: points on its surface and points off it.

FarSpace draws more of what is off it and far away, where something small would stand apart from the solid.

The truth is what the chosen double height fields can say: the intersection of their exact height fields. A point of
a hidden cavity counts as inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ....arrays import F32, F64, Mask
from ....errors import require
from ....mesh.solid import Solid
from ..frames import Frame

AT_WALLS, WALL = 0.25, 0.01  # share of the uniform samples near the walls of the domain boxes, and how near
AROUND, SHELL = 0.15, 0.05  # share of the uniform samples just outside the input's bounding box, and how far
OFFSET = 1e-4  # rays from the surface start this far from it (normalised units)
CLEAR = 0.02  # least distance of FarSpace from the surface
OTHER_SIDE = 0.1  # most distance at which the other side of the exact height fields is looked for
NEAR_SPREADS = (0.01, 0.04)  # standard deviations of the off-surface points' distance from the surface


class Sides:
    """Points of space on the two sides of the exact height fields. Where these fill what no axis sees, their surface
    is far from every face, and it is the nearest point of the other side that tells how far."""

    def __init__(self, space: npt.NDArray[np.floating], excluded: Mask) -> None:
        """space: (M, 3). excluded: (M, K) by which DHF."""
        outside = excluded.any(axis=1)
        spatial = require("scipy.spatial", "encode")
        self._others = [(side, spatial.KDTree(space[outside != side])) for side in (False, True)]

    def nearer(
        self,
        points: npt.NDArray[np.floating],
        excluded: Mask,
        distance: F64,
    ) -> F64:
        """(N,) distance of points (N, 3) from the faces, or from the nearest point of the other side, if that is
        less."""
        outside, least = excluded.any(axis=1), distance.copy()
        for side, others in self._others:
            at = np.flatnonzero(outside == side)
            least[at] = np.minimum(least[at], others.query(points[at], distance_upper_bound=OTHER_SIDE)[0])
        return least


@dataclass(frozen=True, eq=False)
class Samples:
    """N points of the surface that some DHF sees, and M points off the surface; normalised frame.

    surface: (N, 3) float32. seen: (N, K) whether DHF k sees the point. cosine: (N, K) float32 |normal . axis|.
    space: (M, 3) float32. excluded: (M, K) whether DHF k's exact heights leave the point out. distance: (M,) float32
    to the surface. A point of space is inside when no DHF excludes it. sides: the points of space. box: (2, 3) bounding
    box of the input.
    """

    surface: F32
    seen: Mask
    cosine: F32
    space: F32
    excluded: Mask
    distance: F32
    sides: Sides
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
    """`count` points of the surface, uniform by area, and as many of space: a half near the surface, a half uniform in
    the intersection of the domain boxes, which is all the space that the DHFs can fill."""
    rng = np.random.default_rng(seed)
    axes = np.stack([f.rotation[2] for f in frames])
    points, normals = surface_points(solid, count, rng)
    seen = np.stack([visible_points(solid, points, normals, a) for a in axes], axis=1)
    keep = seen.any(axis=1)

    half = count // 2
    spread = np.asarray(NEAR_SPREADS)[np.arange(half) % len(NEAR_SPREADS)]
    near = points[rng.integers(len(points), size=half)] + rng.normal(size=(half, 3)) * spread[:, None]
    box = np.stack([solid.vertices.min(axis=0), solid.vertices.max(axis=0)])
    uniform = _at_walls(_in_boxes(frames, count - half, rng), frames, rng)
    space = np.concatenate([near, _around(uniform, box, rng)])
    space = space[np.lexsort((np.floor(space[:, 2] * 16), np.floor(space[:, 1] * 16), np.floor(space[:, 0] * 16)))]
    excluded = excluded_points(solid, frames, space)
    sides = Sides(space, excluded)
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
    """(N, K): whether the exact heights of each DHF leave a point out."""
    axes = [f.rotation[2] for f in frames]
    excluded = np.stack([(solid.first_hits(points, a) < 0) | (solid.first_hits(points, -a) < 0) for a in axes], axis=1)
    # A ray may leave the solid through a hole of the mesh: what is inside by vote is not excluded.
    doubtful = np.flatnonzero(excluded.any(axis=1))
    excluded[doubtful[solid.contains(points[doubtful])]] = False
    return excluded


class FarSpace:
    """The cells of a grid over all domain boxes that keep clear of the solid: whatever is inside there is a floater."""

    def __init__(self, solid: Solid, frames: list[Frame], sides: Sides, cells: int = 64) -> None:
        """sides: the samples of space. cells: of the grid, on a side."""
        self._solid, self._frames, self._sides = solid, frames, sides
        lo, hi = frames[0].bounds.T
        self._cell = (hi - lo) / cells
        grid = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        corners = lo + grid * self._cell
        centres = (corners + self._cell / 2) @ frames[0].rotation
        reach = float(np.linalg.norm(self._cell)) / 2
        near_boxes = np.ones(len(centres), dtype=bool)
        for f in frames[1:]:
            uvz = centres @ f.rotation.T
            near_boxes &= ((uvz > f.bounds[:, 0] - reach) & (uvz < f.bounds[:, 1] + reach)).all(axis=1)
        corners, centres = corners[near_boxes], centres[near_boxes]
        distance = solid.distances(centres)
        clear = distance > reach + CLEAR
        corners, centres, distance = corners[clear], centres[clear], distance[clear]
        excluded = excluded_points(solid, frames, centres)
        far = sides.nearer(centres, excluded, distance) > reach + CLEAR
        self._corners = corners[far & excluded.any(axis=1)]

    def draw(self, count: int, rng: np.random.Generator) -> F32:
        """(n, 3) about `count` points, fewer where a cell juts out of a box; normalised frame."""
        if not len(self._corners):
            return np.empty((0, 3), dtype=np.float32)
        cells = rng.integers(len(self._corners), size=count)
        uvz = self._corners.take(cells, axis=0) + rng.random((count, 3)) * self._cell
        points = uvz @ self._frames[0].rotation
        inside = np.ones(count, dtype=bool)
        for f in self._frames[1:]:
            inside &= _in_box(f, points)
        return points[inside].astype(np.float32)

    def truth(self, points: F32) -> tuple[Mask, F32]:
        """Which DHFs exclude each of some drawn points, (N, K), and its distance from the surface, (N,)."""
        wide = points.astype(np.float64)
        excluded = excluded_points(self._solid, self._frames, wide)
        distance = self._sides.nearer(wide, excluded, self._solid.distances(wide))
        return excluded, distance.astype(np.float32)


def surface_points(solid: Solid, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
    """(count, 3) points uniform by area, in the order of the faces, and their outward normals."""
    cumulative = np.cumsum(solid.areas)
    face = np.sort(np.searchsorted(cumulative, rng.random(count) * cumulative[-1]))
    face = np.minimum(face, len(cumulative) - 1)
    r1, r2 = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.column_stack([1 - r1, r1 * (1 - r2), r1 * r2])
    return np.einsum("nk,nkd->nd", weights, solid.vertices[solid.faces[face]]), solid.normals[face]


def visible_points(
    solid: Solid,
    points: F64,
    normals: F64,
    axis: F64,
) -> Mask:
    """(N,) whether nothing lies before a surface point on the side of the axis that it faces."""
    toward = np.where((normals @ axis > 0)[:, None], axis, -axis)
    return solid.first_hits(points + OFFSET * normals, toward) < 0


def _in_box(frame: Frame, points: F64) -> Mask:
    """Which of points (N, 3) are in the frame's domain box."""
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
            p = p[_in_box(f, p)]
        parts.append(p)
    return np.concatenate(parts)[:count]


def _at_walls(points: F64, frames: list[Frame], rng: np.random.Generator) -> F64:
    """Move a share of the points to just inside a wall of a domain box: slivers of solid like to stand there, where
    few points of the volume are near."""
    count = round(len(points) * AT_WALLS)
    walls = [(f, axis, side) for f in frames for axis in range(3) for side in range(2)]
    for (f, axis, side), part in zip(walls, np.array_split(np.arange(count), len(walls)), strict=True):
        uvz = points[part] @ f.rotation.T
        uvz[:, axis] = f.bounds[axis, side] + (1 - 2 * side) * rng.random(len(part)) * WALL
        points[part] = uvz @ f.rotation
    return points


def _around(points: F64, box: F64, rng: np.random.Generator) -> F64:
    """Move a share of the points to just outside a side of the bounding box: what juts out there changes its size."""
    chosen = rng.choice(len(points), round(len(points) * AROUND), replace=False)
    axis, side = rng.integers(3, size=len(chosen)), rng.integers(2, size=len(chosen))
    points[chosen, axis] = box[side, axis] + (2 * side - 1) * rng.random(len(chosen)) * SHELL
    return points
