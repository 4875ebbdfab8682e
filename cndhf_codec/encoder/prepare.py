"""From a source to the solid that is encoded, with what had to be assumed on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import MeshError, require
from ..mesh.read import Mesh, checked, read_mesh
from .goal import Length
from .normalise import Normalisation, normalisation
from .solid import Solid
from .thicken import check_thickness, thickened

MOST_OPEN = 0.25  # of the rays from outside may meet sheets: then the rest is worth having without them
# A mesh of more faces is simplified for the fit: the trees over them would take minutes and gigabytes again and again.
MOST_FACES, SIMPLIFIED = 2_000_000, 1_000_000
# How far behind a sheet a body must reach (normalised units). Measured there, inside: 2 % of a bed's single panel, 90 %
# of a draped cloth, all of an open box.
BEHIND = 0.01
ROUNDING = 0.001  # a smaller share is not worth a line: of rays, a face seen from behind at a silhouette


@dataclass(frozen=True, eq=False)
class Prepared:
    """given: the input, and flipped, the share of its surface whose orientation was reversed. norm: the frame of what
    follows. solid: what is encoded, of a simplified mesh where the input is very large. reference: vertices and faces
    that the error is measured against: the input's, with its walls if it was thickened. diagonal: of the input's
    bounding box, input units. assumptions: a line for each thing taken for granted. refusal: why there is no solid to
    encode, with the remedy, or None.
    """

    given: Mesh
    flipped: float
    norm: Normalisation
    solid: Solid
    reference: tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]
    diagonal: float
    assumptions: list[str]
    refusal: str | None


def prepare(source: Any, thicken: Length | None = None) -> Prepared:
    """Read a source (see `read_mesh`) and make it a solid; thicken: of the wall that sheets get. Raises InputError, and
    MeshError for what is no mesh or a wall that cannot be made; a surface too open to be a solid is a `refusal`."""
    given = mesh = read_mesh(source)
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    norm = normalisation(mesh)
    solid = _solid(mesh, norm)
    assumptions, flipped = _repairs(solid), solid.flipped
    if len(mesh.faces) > MOST_FACES:
        assumptions.append(
            f"the fit works on {len(solid.given)} faces, simplified from {len(mesh.faces)}; "
            "the error is measured against all of them"
        )
    if mesh.dropped:
        assumptions.append(f"{mesh.dropped} faces of zero area were left out")
    refusal = None
    if thicken is not None:
        thickness = thicken.in_units(diagonal)
        check_thickness(thickness, diagonal, mesh.name)
        if solid.open:
            assumptions.append(
                f"sheets, {100 * solid.open:.1f} % of what is seen from outside, got a wall of {thickness:.4g}"
            )
            mesh = thickened(solid, norm, thickness, mesh.name)
            norm = normalisation(mesh)
            solid = _solid(mesh, norm)
        else:
            assumptions.append("the surface has no sheets: nothing was thickened")
    elif solid.open > MOST_OPEN:
        refusal = (
            f"{mesh.name}: it has no inside: {100 * solid.open:.0f} % of what is seen from outside are open sheets "
            "(a cloth, a range scan, walls without thickness); close them, or give them a wall with --thicken, such as "
            f"--thicken 1% ({0.01 * diagonal:.3g} in its units)"
        )
    reference = solid.vertices, solid.given
    if len(mesh.faces) > MOST_FACES:
        reference = norm.apply(mesh.vertices), mesh.faces
    if solid.open and not refusal:
        bare = _bare(solid)
        if bare.any():
            share = solid.areas[bare].sum() / solid.areas.sum()
            assumptions.append(
                f"sheets without thickness, {100 * share:.1f} % of the surface, were left out; "
                "--thicken gives them a wall"
            )
            used, numbers = np.unique(solid.faces[~bare], return_inverse=True)
            solid = Solid(solid.vertices[used], numbers.reshape(-1, 3).astype(np.int64))
    if not refusal and solid.behind > ROUNDING:
        assumptions.append(
            f"the surface is open: {100 * solid.behind:.1f} % of the rays from outside came in through a hole, "
            "which comes back closed"
        )
    return Prepared(given, flipped, norm, solid, reference, diagonal, assumptions, refusal)


def solid_or_error(prepared: Prepared) -> Solid:
    """The solid. Raises MeshError where the mesh is refused."""
    if prepared.refusal is not None:
        raise MeshError(prepared.refusal)
    return prepared.solid


def _solid(mesh: Mesh, norm: Normalisation) -> Solid:
    vertices, faces = norm.apply(mesh.vertices), mesh.faces
    if len(faces) > MOST_FACES:
        simplify = require("fast_simplification", "encode").simplify
        # agg: how greedily. 3 comes nearer to the surface than the default of 7; less may stop before the count.
        fewer = simplify(vertices.astype(np.float32), faces.astype(np.int32), target_count=SIMPLIFIED, agg=3)
        small = checked(fewer[0], fewer[1], mesh.name)
        vertices, faces = small.vertices, small.faces
    return Solid(vertices, faces)


def _bare(solid: Solid) -> npt.NDArray[np.bool_]:
    """(M,) faces of sheets that nothing closes to a body: just behind them is outside. To keep them would leave threads
    of them in the fit."""
    at = np.flatnonzero(solid.sheet)
    points = solid.vertices[solid.faces[at]].mean(axis=1) - BEHIND * solid.normals[at]
    patch = solid.repaired.patch
    inside = np.bincount(patch[at], weights=solid.areas[at] * solid.contains(points), minlength=patch.max() + 1)
    whole = np.bincount(patch[at], weights=solid.areas[at], minlength=patch.max() + 1)
    return solid.sheet & (inside < whole / 2)[patch]


def _repairs(solid: Solid) -> list[str]:
    repaired, out = solid.repaired, []
    if solid.flipped > ROUNDING:
        out.append(f"{100 * solid.flipped:.1f} % of the surface faced inward and was turned round")
    doubled = solid.areas[repaired.doubled].sum() / solid.areas.sum()
    if doubled > ROUNDING:
        out.append(f"{100 * doubled:.1f} % of the surface was given in both orientations and is taken once")
    if repaired.repeated:
        out.append(f"{repaired.repeated} faces were copies of others and were left out")
    if repaired.dropped_pairs:
        out.append(f"{repaired.dropped_pairs} pairs of opposite faces (walls between parts, flaps) were left out")
    return out
