"""What a mesh is like and what would become of it, without encoding it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import I64
from ..decoder.parallel import processors
from ..errors import require
from ..mesh.bodies import bodies_of_solid, filled_volume, piercing
from ..mesh.prepare import prepare
from ..mesh.repair import Edges, connected, edges_of
from .dhf.axes.costs import AxisCosts
from .pipeline import check_seed, hidden_warning, unseen
from .settings import PRESETS
from .size_search import parse_length
from .thread_pool import Team


@dataclass(frozen=True)
class Check:
    """A mesh as the encoder sees it. Lengths are in input units, shares of 1.

    dropped_faces: of zero area. components: parts that share no vertex. boundary_edges: of one face, in
    boundary_loops connected chains. nonmanifold_edges: of three faces or more. flipped: share of the surface whose
    orientation is reversed. self_intersections: share of (at most 200,000 sampled) edges that pierce another face.
    parts: bodies of the solid that do not touch each other, and minor_parts: those shorter than a hundredth of the
    largest. volume: of the solid, exact for a closed surface that does not go through itself, else from 30,000 points.
    hidden: share of the surface that no axis sees, which will be filled. filled, floor: the volume that exact height
    fields along the `axes` best axes would add, and the mean error that they would leave by it. assumptions: a line for
    each thing that would be taken for granted. refusal: why it would not be encoded, or None; then what is said of the
    solid is None.
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
    parts: int | None
    minor_parts: int | None
    volume: float | None
    filled: float | None
    hidden: float | None
    axes: int | None
    floor: float | None
    assumptions: list[str]
    refusal: str | None


def check(source: Any, *, thicken: float | str | None = None, unit: str | None = None, seed: int = 0) -> Check:
    """Look at a mesh as `encode` would. source, thicken, unit and seed are as there.

    A surface that `encode` refuses, for being open or too thin, has a `refusal`. Raises InputError and MeshError for
    what is no mesh, OptionError, and MissingExtraError (the `encode` extra).
    """
    check_seed(seed)
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    for library in ("embreex", "igl", "trimesh"):
        require(library, "encode")
    prepared = prepare(source, wall)
    mesh, solid, scale = prepared.given, prepared.solid, prepared.norm.scale
    edges = edges_of(mesh.faces, len(mesh.vertices))
    boundary = _boundary(mesh.faces, edges)
    pierced = piercing(solid, seed)
    parts = minor_parts = volume = filled = hidden = axes = floor = None
    assumptions, refusal = prepared.assumptions, prepared.refusal
    if refusal is None:
        bodies = bodies_of_solid(solid, seed, pierced).scaled(scale)
        parts, minor_parts, volume = bodies.parts, bodies.minor, bodies.volume
        with Team(min(4, processors())) as team:
            costs = AxisCosts(solid, seed, team)
        hidden = 1 - costs.visible
        assumptions = [*assumptions, *hidden_warning(costs.visible)]
        if costs.visible > 0:
            axes = PRESETS["default"].max_axes or 1
            chosen = costs.best(axes)
            # One of the two directions of the mean error sees what is filled.
            floor = costs.depth(chosen) / 2 * scale
            filled = filled_volume(solid, costs.axes[chosen]) * scale**3
        else:
            refusal = unseen(mesh.name)
    x, y, z = (float(e) for e in prepared.extents)
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
        self_intersections=float(pierced[1].mean()),
        parts=parts,
        minor_parts=minor_parts,
        volume=volume,
        filled=filled,
        hidden=hidden,
        axes=axes,
        floor=floor,
        assumptions=assumptions,
        refusal=refusal,
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
