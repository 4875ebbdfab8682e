"""Check a mesh: what it is like and what would become of it, without encoding it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import I64
from ..decoder.parallel import processors
from ..errors import require_all
from ..mesh.bodies import bodies_of_solid, filled_volume, piercing
from ..mesh.connectivity import Edges, chains, edges_of, face_components
from ..mesh.lengths import parse_length
from ..mesh.prepare import as_given, as_solid
from ..mesh.unite import United, united
from .dhf.axes.costs import AxisCosts
from .dhf.settings import DEFAULT
from .pipeline import check_seed
from .report import hidden_warning, unseen
from .thread_pool import ThreadPool


@dataclass(frozen=True)
class Check:
    """A mesh as the encoder sees it. Lengths are in input units, shares of 1.

    Attributes
    ----------
    name : str
        Of the file.
    vertices, faces : int
        How many, after equal positions are merged and faces of zero area left out.
    dropped_faces : int
        Faces of zero area.
    extents, diagonal : tuple of float, float
        Of the bounding box.
    components : int
        Parts that share no vertex.
    boundary_loops, boundary_edges : int
        Connected chains of edges of one face, and such edges.
    nonmanifold_edges : int
        Edges of three faces or more.
    flipped : float
        Share of the surface whose orientation is reversed.
    self_intersections : float
        Share of the edges (at most 200,000 sampled ones) that pierce another face.
    parts, minor_parts : int or None
        Parts of the solid, where those that touch count as one; minor ones are shorter than 1/100 of the largest.
    volume : float or None
        Of the solid: exact for a closed surface that does not pierce itself, else from 30,000 points.
    united : United or None
        With `solid`: numbers of parts, `before` and `after` they were united, and the `volume` after.
        Self-intersections, parts and what follows are then those of the united solid.
    hidden : float or None
        Share of the surface that no axis sees, which double height fields fill.
    axes : int or None
        Number of axes that the next two assume: that of preset `default`.
    filled, error_lower_bound : float or None
        Volume that the exact height fields along the best axes would fill, and the mean error that this would cause.
    lost : list of str
        What the mesh holds beside its shape, which is not kept; see `Report`.
    assumptions : list of str
        A line for each thing that would be assumed.
    dhf_assumptions : list of str
        Lines for what double height fields would assume besides.
    refusal : str or None
        Why it would not be encoded as double height fields, but only as a surface; then what describes the solid is
        None.
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
    united: United | None
    filled: float | None
    hidden: float | None
    axes: int | None
    error_lower_bound: float | None
    lost: list[str]
    assumptions: list[str]
    dhf_assumptions: list[str]
    refusal: str | None


def check(
    source: Any,
    *,
    thicken: float | str | None = None,
    unit: str | None = None,
    solid: bool = False,
    seed: int = 0,
) -> Check:
    """Look at a mesh as `encode` would, without encoding it.

    Parameters
    ----------
    source, thicken, unit, solid, seed
        As of `encode`.

    Returns
    -------
    Check
        What can only be encoded as a surface, for being open or too thin, has a `refusal`.

    Raises
    ------
    InputError, MeshError
        For what cannot be read or is no mesh, and with `solid` for what has no inside.
    OptionError
        When an argument is of a wrong type or out of range.
    MissingExtraError
        When the `encode` extra is not installed.

    Examples
    --------
    >>> import cndhf_codec
    >>> found = cndhf_codec.check("examples/bracket.ply")
    >>> found.faces, found.parts, found.refusal
    (2464, 1, None)
    """
    seed = check_seed(seed)
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    require_all(("embreex", "igl", "trimesh"), "encode")
    given, whole = as_given(source), None
    if solid:
        given, whole = united(as_solid(given, wall), seed)
        wall = None
    prepared = as_solid(given, wall)
    mesh, body, scale = prepared.given, prepared.solid, prepared.norm.scale
    edges = edges_of(mesh.faces, len(mesh.vertices))
    boundary = _boundary(mesh.faces, edges)
    pierced = piercing(body, seed)
    parts = minor_parts = volume = filled = hidden = axes = bound = None
    assumptions, refusal = (given if wall is None else prepared).assumptions, prepared.refusal
    of_solid = prepared.assumptions[len(assumptions) :]
    if refusal is None:
        bodies = bodies_of_solid(body, seed, pierced).scaled(scale)
        parts, minor_parts, volume = bodies.parts, bodies.minor, bodies.volume
        with ThreadPool(min(4, processors())) as threads:
            costs = AxisCosts(body, seed, threads)
        hidden = 1 - costs.visible
        of_solid = [*of_solid, *hidden_warning(costs.visible)]
        if costs.visible > 0:
            axes = DEFAULT.max_axes
            chosen = costs.best(axes)
            # Only one of the two directed distances in the mean error sees what is filled.
            bound = costs.depth(chosen) / 2 * scale
            filled = filled_volume(body, costs.axes[chosen]) * scale**3
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
        components=int(face_components(mesh.faces, len(mesh.vertices)).max()) + 1,
        boundary_loops=chains(boundary),
        boundary_edges=len(boundary),
        nonmanifold_edges=int((edges.count > 2).sum()),
        flipped=prepared.flipped,
        self_intersections=float(pierced[1].mean()),
        parts=parts,
        minor_parts=minor_parts,
        volume=volume,
        united=whole,
        filled=filled,
        hidden=hidden,
        axes=axes,
        error_lower_bound=bound,
        lost=list(mesh.lost),
        assumptions=assumptions,
        dhf_assumptions=of_solid,
        refusal=refusal,
    )


def _boundary(faces: I64, edges: Edges) -> I64:
    """Find the vertices (B, 2) of the edges that have one face."""
    side, face = np.nonzero(edges.count[edges.of] == 1)
    return np.stack([faces[face, side], faces[face, (side + 1) % 3]], axis=1)
