"""Count the parts of a shape and measure its volume, to tell whether an encode has changed them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import F64, I32, I64, Mask
from .connectivity import component_boxes, connected, edges_of, face_components
from .sampling import draw_faces, points_in
from .solid import Solid, signed_volumes

# Evidence for these constants: ADR 003.
MINOR_LENGTH = 0.01  # of the largest part's length; shorter parts are counted apart: few would see them come or go
TOUCH_POINTS = 50_000  # points of the surface from which neighbouring parts are looked for
# Parts closer than this touch (normalised units). It is a sixteenth of a cell of the default resolution: no fit of some
# kilobytes keeps such parts apart.
TOUCH = 5e-4
EDGES = 200_000  # most edges that are tested for piercing faces
LEAST_DEPTH = 1e-6  # how far an edge must go through a face to count (normalised units; float32 rays)
VOLUME_POINTS, FIRST_LOOK_EVERY = 30_000, 15  # points of the bounding box; every 15th is tried first

Piercing = tuple[I64, Mask, I32]


@dataclass(frozen=True)
class Bodies:
    """Parts and volume of a shape.

    parts: number of parts; those that touch count as one. minor: number of further parts, shorter than MINOR_LENGTH
    times the largest. volume: of all parts, in cubed units of the input. noise: relative error of the volume, three
    standard deviations. closed: whether the surface is closed; if not, parts are guessed.
    """

    parts: int
    minor: int
    volume: float
    noise: float = 0.0
    closed: bool = True

    def scaled(self, factor: float) -> Bodies:
        return replace(self, volume=self.volume * factor**3)


def bodies_of_surface(vertices: F64, faces: I64) -> Bodies:
    """Measure a surface without self-intersections, such as a decoder makes. Cavities are no parts."""
    label = face_components(faces, len(vertices))
    volumes = np.bincount(label, weights=signed_volumes(vertices, faces)).astype(np.float64)
    parts, minor = _counted(vertices, faces, label, volumes)
    closed = bool((edges_of(faces, len(vertices)).count == 2).all())
    return Bodies(parts, minor, float(volumes.sum()), closed=closed)


def bodies_of_solid(solid: Solid, seed: int, edges: Piercing | None = None) -> Bodies:
    """Measure a solid, whose parts may overlap, touch or be open (normalised units). edges: the result of `piercing`,
    if known."""
    label = face_components(solid.faces, len(solid.vertices))
    pairs, pierced, face = edges or piercing(solid, seed)
    single = label.max() == 0
    if not single:
        of_vertex = np.zeros(len(solid.vertices), dtype=np.int64)
        of_vertex[solid.faces] = label[:, None]
        a, b = _neighbours(solid, label, seed)
        a = np.concatenate([a, of_vertex[pairs[pierced, 0]]])
        b = np.concatenate([b, label[face[pierced]]])
        label = connected(a, b, int(label.max()) + 1)[label]
    volumes = np.bincount(label, weights=signed_volumes(solid.vertices, solid.faces)).astype(np.float64)
    parts, minor = _counted(solid.vertices, solid.faces, label, volumes)
    volume, noise = _volume(solid, single and not pierced.any())
    return Bodies(max(parts, 1), minor, volume, noise, solid.closed)


def _volume(solid: Solid, simple: bool) -> tuple[float, float]:
    """Measure the volume and its noise: exactly for a closed, simple surface, else from sample points.

    simple: no part pierces another, or itself. The signed volume of a closed surface is the integral of its winding
    number w. The solid is where w > 1/2, so the signed volume is too large by the integral of w - [w > 1/2], which is
    zero except where parts overlap.
    """
    points, box = _spread(solid)
    if not solid.closed:
        share = float((solid.winding_numbers(points) > 0.5).mean())
        return box * share, 3 * float(np.sqrt((1 - share) / max(share * len(points), 1)))
    signed = solid.signed_volume
    # A part may lie within another without piercing it. A few points show whether one does.
    if simple and not _surplus(solid, points[::FIRST_LOOK_EVERY]).any():
        return signed, 0.0
    surplus = _surplus(solid, points)
    volume = signed - box * float(surplus.mean())
    return volume, 3 * box * float(surplus.std()) / np.sqrt(len(points)) / max(abs(volume), 1e-300)


def _surplus(solid: Solid, points: F64) -> F64:
    """(N,) how often the signed volume counts points (N, 3) too much: the winding number, less 1 inside the solid."""
    winding = solid.winding_numbers(points)
    return np.rint(winding) - (winding > 0.5)


def filled_volume(solid: Solid, axes: F64) -> float:
    """Measure the volume that the exact height fields along axes (K, 3) fill beyond the solid (normalised units).

    A point is in their intersection when rays both ways along every axis meet the surface.
    """
    points, box = _spread(solid)
    within = np.ones(len(points), dtype=bool)
    for direction in (*axes, *-axes):
        at = np.flatnonzero(within)
        within[at] = solid.first_hits(points[at], direction) >= 0
    at = np.flatnonzero(within)
    return box * float((~solid.contains(points[at])).sum()) / len(points)


def _spread(solid: Solid) -> tuple[F64, float]:
    """(VOLUME_POINTS, 3) points of the solid's bounding box, and the box's volume. Roberts' sequence is more even than
    random points, and as good as several times as many of them."""
    corners = solid.vertices[solid.faces]
    lo, hi = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    steps = np.outer(np.arange(VOLUME_POINTS), 1.2207440846057596 ** -np.arange(1.0, 4))
    return lo + (steps + 0.5) % 1 * (hi - lo), float((hi - lo).prod())


def piercing(solid: Solid, seed: int) -> Piercing:
    """Find edges that pierce a face with which they share no vertex.

    Returns edges (E, 2), at most EDGES drawn at random; whether each pierces a face, (E,); and that face, (E,).
    """
    pairs = np.concatenate([solid.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    if len(pairs) > EDGES:
        pairs = pairs[np.random.default_rng(seed).choice(len(pairs), EDGES, replace=False)]
    a, b = solid.vertices[pairs[:, 0]], solid.vertices[pairs[:, 1]]
    pierced, face = np.zeros(len(pairs), dtype=bool), np.full(len(pairs), -1, dtype=np.int32)
    for start, end in ((a, b), (b, a)):  # from either end: the first face hit may be a neighbour
        hit = solid.first_hits(start + 1e-4 * (end - start), end - start)
        through = _through(solid, start, end, pairs, hit)
        face[through & ~pierced] = hit[through & ~pierced]
        pierced |= through
    return pairs, pierced, face


def _through(solid: Solid, start: F64, end: F64, pairs: I64, face: I32) -> Mask:
    """Check in float64 whether segments pass through the faces that float32 rays along them hit, (E,)."""
    corners = solid.faces[face]
    strangers = (corners[:, :, None] != pairs[:, None, :]).all(axis=(1, 2))
    corner, normal = solid.vertices[corners[:, 0]], solid.normals[face]
    before, behind = (((p - corner) * normal).sum(axis=1) for p in (start, end))
    deep = np.minimum(np.abs(before), np.abs(behind)) > LEAST_DEPTH
    return (face >= 0) & strangers & (before * behind < 0) & deep


def _counted(vertices: F64, faces: I64, label: I64, volumes: F64) -> tuple[int, int]:
    """Count parts and minor parts. Labels without positive volume are cavities or scraps, and do not count."""
    lo, hi = component_boxes(vertices, faces, label)
    length = np.linalg.norm(hi - lo, axis=1)
    minor = length < MINOR_LENGTH * length.max()
    return int((~minor & (volumes > 0)).sum()), int((minor & (volumes > 0)).sum())


def _neighbours(solid: Solid, label: I64, seed: int) -> tuple[I64, I64]:
    """Find pairs of components that overlap or touch, or of which one lies within the other.

    Rays start just in front of a component's surface and go away from it. Where one hits another component from behind,
    it began inside that component.
    """
    rng = np.random.default_rng(seed)
    face = np.concatenate([draw_faces(solid.areas, TOUCH_POINTS, rng), np.unique(label, return_index=True)[1]])
    points = points_in(solid.vertices[solid.faces[face]], rng)
    normals = solid.normals[face]
    hit = solid.first_hits(points + TOUCH * normals, normals)
    behind = (hit >= 0) & ((solid.normals[hit] * normals).sum(axis=1) > 0)
    return label[face[behind]], label[hit[behind]]
