"""What a mesh is like and what would become of it, without encoding it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..decoder.parallel import processors
from ..errors import require
from .axisset import AxisCosts
from .goal import parse_length
from .pipeline import hidden_warning
from .prepare import prepare
from .repair import I64, Edges, connected, edges_of
from .settings import PRESETS
from .solid import Solid
from .team import Team

VOLUME_SAMPLES = 200_000
EDGE_SAMPLES = 200_000
LEAST_DEPTH = 1e-6  # how far an edge must go through a face to count (normalised units; float32 rays)


@dataclass(frozen=True)
class Check:
    """A mesh as the encoder sees it. Lengths are in input units, shares of 1.

    dropped_faces: of zero area. components: parts that share no vertex. boundary_edges: of one face, in
    boundary_loops connected chains. nonmanifold_edges: of three faces or more. flipped: share of the surface whose
    orientation is reversed. self_intersections: share of (at most 200,000 sampled) edges that pierce another face.
    volume: of the solid, estimated from 200,000 points. hidden: share of the surface that no axis sees, which will be
    filled. floor: mean error that exact height fields along the `axes` best axes would leave: what they fill in.
    assumptions: a line for each thing that would be taken for granted. refusal: why it would not be encoded, or None;
    then what is said of the solid is None.
    """

    name: str
    vertices: int
    faces: int
    dropped_faces: int
    extents: tuple[float, float, float]
    diagonal: float
    components: int
    boundary_loops: int
    boundary_edges: int
    nonmanifold_edges: int
    flipped: float
    self_intersections: float
    volume: float | None
    hidden: float | None
    axes: int | None
    floor: float | None
    assumptions: list[str]
    refusal: str | None


def check(source: Any, *, thicken: float | str | None = None, unit: str | None = None, seed: int = 0) -> Check:
    """Look at a mesh as `encode` would. source, thicken, unit and seed are as there.

    A surface that `encode` refuses for being open has a `refusal`. Raises InputError and MeshError for what is no mesh,
    OptionError, and MissingExtraError (the `encode` extra).
    """
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    for library in ("embreex", "igl", "trimesh"):
        require(library, "encode")
    prepared = prepare(source, wall)
    mesh, solid, scale = prepared.given, prepared.solid, prepared.norm.scale
    edges = edges_of(mesh.faces, len(mesh.vertices))
    boundary = _boundary(mesh.faces, edges)
    volume = hidden = axes = floor = None
    assumptions = prepared.assumptions
    if prepared.refusal is None:
        volume = _volume(solid, seed) * scale**3
        with Team(min(4, processors())) as team:
            costs = AxisCosts(solid, seed, team)
        hidden = 1 - costs.visible
        assumptions = [*assumptions, *hidden_warning(costs.visible)]
        if costs.visible > 0:
            axes = PRESETS["default"].max_axes or 1
            # One of the two directions of the mean error sees what is filled.
            floor = costs.depth(costs.best(axes)) / 2 * scale
    x, y, z = (float(e) for e in np.ptp(mesh.vertices, axis=0))
    return Check(
        name=mesh.name,
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        dropped_faces=mesh.dropped,
        extents=(x, y, z),
        diagonal=prepared.diagonal,
        components=_parts(mesh.faces[:, :2], mesh.faces[:, 1:]),
        boundary_loops=_parts(boundary),
        boundary_edges=len(boundary),
        nonmanifold_edges=int((edges.count > 2).sum()),
        flipped=prepared.flipped,
        self_intersections=_self_intersections(solid, seed),
        volume=volume,
        hidden=hidden,
        axes=axes,
        floor=floor,
        assumptions=assumptions,
        refusal=prepared.refusal,
    )


def _boundary(faces: I64, edges: Edges) -> I64:
    """(B, 2) the vertices of the edges of one face."""
    side, face = np.nonzero(edges.count[edges.of] == 1)
    return np.stack([faces[face, side], faces[face, (side + 1) % 3]], axis=1)


def _parts(*links: I64) -> int:
    """How many connected parts pairs of numbers make."""
    distinct, numbers = np.unique(np.concatenate(links), return_inverse=True)
    numbers = numbers.reshape(-1, 2)
    return int(connected(numbers[:, 0], numbers[:, 1], len(distinct)).max(initial=-1)) + 1


def _volume(solid: Solid, seed: int) -> float:
    """Share of random points of the bounding box that are inside, times its volume."""
    lo, hi = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    points = lo + np.random.default_rng(seed).random((VOLUME_SAMPLES, 3)) * (hi - lo)
    return float(solid.contains(points).mean() * (hi - lo).prod())


def _self_intersections(solid: Solid, seed: int) -> float:
    """Share of edges that pierce a face with which they share no vertex."""
    pairs = np.concatenate([solid.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    if len(pairs) > EDGE_SAMPLES:
        pairs = pairs[np.random.default_rng(seed).choice(len(pairs), EDGE_SAMPLES, replace=False)]
    a, b = solid.vertices[pairs[:, 0]], solid.vertices[pairs[:, 1]]
    pierced = np.zeros(len(pairs), dtype=bool)
    for start, end in ((a, b), (b, a)):  # from either end: the first face that is hit may be a neighbour
        hit = solid.first_hits(start + 1e-4 * (end - start), end - start)
        pierced |= _pierces(solid, start, end, pairs, hit)
    return float(pierced.mean())


def _pierces(
    solid: Solid,
    start: npt.NDArray[np.float64],
    end: npt.NDArray[np.float64],
    pairs: I64,
    face: npt.NDArray[np.int32],
) -> npt.NDArray[np.bool_]:
    """Whether segments truly pass through the faces that rays along them hit, in float64."""
    corners = solid.faces[face]
    strangers = (corners[:, :, None] != pairs[:, None, :]).all(axis=(1, 2))
    corner, normal = solid.vertices[corners[:, 0]], solid.normals[face]
    before, behind = (((p - corner) * normal).sum(axis=1) for p in (start, end))
    through = (before * behind < 0) & (np.minimum(np.abs(before), np.abs(behind)) > LEAST_DEPTH)
    return (face >= 0) & strangers & through
