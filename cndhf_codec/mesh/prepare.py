"""Make the solid that is encoded from a source, and tell what had to be assumed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import F64, I64, Mask
from ..errors import MeshError, require
from ..format.constants import BOX_STEP
from .lengths import Length
from .normalise import Normalisation, normalisation
from .outliers import without_outliers
from .read import Mesh, checked, read_mesh
from .solid import Solid
from .thicken import check_thickness, thickened
from .wording import percent

# Evidence for these constants: ADR 002; LEAST_THICKNESS: 030.
MOST_OPEN = 0.25  # of the rays from outside may meet sheets; a mesh of more is refused, one of less loses its sheets
# A mesh of more faces is simplified for the fit: each tree over all of them would take minutes and gigabytes.
MOST_FACES, SIMPLIFIED = 2_000_000, 1_000_000
# Distance behind a sheet at which the solid is looked for (normalised units). Measured share that is inside there: 2 %
# of a bed's single panel, 90 % of a draped cloth, all of an open box.
BEHIND = 0.01
LEAST_THICKNESS = 4 * BOX_STEP  # normalised units: a domain box is rounded by up to a step at either side
WORTH_A_LINE = 0.001  # smaller shares are not reported: faces at silhouettes are seen from behind by a few rays


@dataclass(frozen=True, eq=False)
class AsGiven:
    """A mesh made ready to be encoded as the surface that it is, sheets and inner parts with it.

    given: the input. mesh: the same without tiny parts far away, in input coordinates. flipped: share of its surface
    whose orientation was reversed. norm: frame of solid and reference.
    solid: what is encoded, from a simplified mesh where the input is very large. reference: vertices and faces that the
    error is measured against: the input's, with its walls if it was thickened, without tiny parts far away. extents: of
    the input's bounding box, without such parts, in input units. assumptions: a line for each thing that was assumed.
    """

    given: Mesh
    mesh: Mesh
    flipped: float
    norm: Normalisation
    solid: Solid
    reference: tuple[F64, I64]
    extents: F64
    assumptions: list[str]

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box, in input units."""
        return float(np.linalg.norm(self.extents))


@dataclass(frozen=True, eq=False)
class Prepared(AsGiven):
    """A mesh made ready to be encoded as a solid.

    refusal: why there is no solid to encode, with the remedy, or None.
    """

    refusal: str | None


def prepare(source: Any, thicken: Length | None = None) -> Prepared:
    """Read a source (see `read_mesh`) and make it a solid: `as_given`, then `as_solid`, with their errors."""
    return as_solid(as_given(source), thicken)


def as_solid(made: AsGiven, thicken: Length | None = None) -> Prepared:
    """Make a mesh a solid.

    thicken: thickness of the wall that sheets get. Raises MeshError for a wall that cannot be made. A surface too open
    to be a solid, or too thin for a file, gets a `refusal`.
    """
    given, mesh, norm, solid, assumptions = made.given, made.mesh, made.norm, made.solid, [*made.assumptions]
    if len(mesh.faces) > MOST_FACES:
        assumptions.append(
            f"the fit works on {len(solid.given)} faces, simplified from {len(mesh.faces)}; "
            "the error is measured against all of them"
        )
    extents = made.extents
    refusal = None
    if thicken is not None:
        thickness = thicken.in_units(float(np.linalg.norm(extents)))
        walled, line = _with_walls(mesh, norm, solid, thickness, extents)
        assumptions.append(line)
        if walled is not mesh:
            mesh, norm = walled, normalisation(walled)
            solid = _solid(mesh, norm)
    elif solid.open > MOST_OPEN:
        refusal = _no_inside(mesh.name, solid, extents)
    reference = _reference(mesh, norm, solid)
    if refusal is None:
        bare = _bare(solid) if solid.open else np.zeros(len(solid.faces), dtype=bool)
        if bare.any():
            assumptions.append(_left_out(solid, norm, bare))
            kept = _without(solid, norm, bare, mesh.name)
            # The frame fits the faces that are kept; the error is measured against all that were given.
            given_vertices, norm = norm.undo(reference[0]), normalisation(kept)
            solid, reference = _solid(kept, norm), (norm.apply(given_vertices), reference[1])
        if solid.behind > WORTH_A_LINE:
            assumptions.append(
                f"the surface is open: {percent(solid.behind)} of the rays from outside came in through a hole, "
                "which comes back closed"
            )
        refusal = _too_thin(mesh.name, solid, norm)
    return Prepared(given, mesh, made.flipped, norm, solid, reference, extents, assumptions, refusal)


def as_given(source: Any) -> AsGiven:
    """Read a source (see `read_mesh`) as a surface, which may be open.

    Raises InputError, and MeshError for what is no mesh.
    """
    given = read_mesh(source)
    assumptions = list(given.notes)
    if given.dropped:
        assumptions.append(f"{given.dropped} faces of zero area were left out")
    mesh, outliers = without_outliers(given)
    norm = normalisation(mesh)
    solid = _solid(mesh, norm)
    assumptions += [*outliers, *_repairs(solid)]
    extents = np.ptp(mesh.vertices, axis=0)
    return AsGiven(given, mesh, solid.flipped, norm, solid, _reference(mesh, norm, solid), extents, assumptions)


def _reference(mesh: Mesh, norm: Normalisation, solid: Solid) -> tuple[F64, I64]:
    """Vertices and faces, normalised, that the error is measured against: all of the mesh, simplified or not."""
    if len(mesh.faces) > MOST_FACES:
        return norm.apply(mesh.vertices), mesh.faces
    return solid.vertices, solid.given


def solid_or_error(prepared: Prepared) -> Solid:
    """Return the solid. Raises MeshError where the mesh is refused."""
    if prepared.refusal is not None:
        raise MeshError(prepared.refusal)
    return prepared.solid


def _solid(mesh: Mesh, norm: Normalisation) -> Solid:
    vertices, faces = norm.apply(mesh.vertices), mesh.faces
    if len(faces) > MOST_FACES:
        simplify = require("fast_simplification", "encode").simplify
        # agg: how greedy. 3 stays nearer to the surface than the default of 7; less may stop before the count.
        fewer = simplify(vertices.astype(np.float32), faces.astype(np.int32), target_count=SIMPLIFIED, agg=3)
        small = checked(fewer[0], fewer[1], mesh.name)
        vertices, faces = small.vertices, small.faces
    return Solid(vertices, faces)


def _with_walls(mesh: Mesh, norm: Normalisation, solid: Solid, thickness: float, extents: F64) -> tuple[Mesh, str]:
    """Replace the sheets of a mesh by a wall; return also a line that says so. Thickness, extents: input units."""
    check_thickness(thickness, float(np.linalg.norm(extents)), mesh.name)
    if not solid.open:
        return mesh, "the surface has no sheets: nothing was thickened"
    line = f"sheets, {percent(solid.open)} of what is seen from outside, got a wall of {thickness:.4g}"
    return thickened(solid, norm, thickness, mesh.name), line


def _no_inside(name: str, solid: Solid, extents: F64) -> str:
    return (
        f"{name}: it has no inside: {100 * solid.open:.0f} % of what is seen from outside are open sheets "
        "(a cloth, a range scan, walls without thickness); close them, or give them a wall with --thicken, such as "
        f"--thicken 1% ({0.01 * float(np.linalg.norm(extents)):.3g} in its units)"
    )


def _too_thin(name: str, solid: Solid, norm: Normalisation) -> str | None:
    """Say why a solid is too thin for a file, or None. Thickness is that of a plate; for a rod it is the radius."""
    if not solid.closed:
        return None
    thickness = 2 * abs(solid.signed_volume) / float(solid.areas.sum())
    if thickness >= LEAST_THICKNESS:
        return None
    return (
        f"{name}: it is {thickness * norm.scale:.3g} thick, less than a {1 / LEAST_THICKNESS:.0f}th of its size: "
        "thinner than a file can tell; thicken it"
    )


def _bare(solid: Solid) -> Mask:
    """(M,) whether a face is of a sheet that bounds no solid: just behind it is outside. A fit would leave threads of
    such sheets."""
    at = np.flatnonzero(solid.sheet)
    points = solid.vertices[solid.faces[at]].mean(axis=1) - BEHIND * solid.normals[at]
    patch = solid.repaired.patch
    inside = np.bincount(patch[at], weights=solid.areas[at] * solid.contains(points), minlength=patch.max() + 1)
    whole = np.bincount(patch[at], weights=solid.areas[at], minlength=patch.max() + 1)
    return solid.sheet & (inside < whole / 2)[patch]


def _without(solid: Solid, norm: Normalisation, faces: Mask, name: str) -> Mesh:
    """Make a mesh, in input coordinates, of the solid without some faces."""
    used, numbers = np.unique(solid.faces[~faces], return_inverse=True)
    return checked(norm.undo(solid.vertices[used]), numbers.reshape(-1, 3), name)


def _left_out(solid: Solid, norm: Normalisation, faces: Mask) -> str:
    share = solid.areas[faces].sum() / solid.areas.sum()
    return (
        f"sheets without thickness, {percent(share)} of the surface, {_place(solid, norm, faces)}, "
        "were left out; --thicken gives them a wall"
    )


def _place(solid: Solid, norm: Normalisation, faces: Mask) -> str:
    """Say where some faces are, in input coordinates."""
    corners = norm.undo(solid.vertices[solid.faces[faces]].reshape(-1, 3))
    ends = np.stack([corners.min(axis=0), corners.max(axis=0)])
    ends = np.round(ends, 3 - int(np.ceil(np.log10(np.ptp(ends, axis=0).max())))) + 0.0  # thousandths of their size
    lo, hi = (", ".join(f"{x:g}" for x in end) for end in ends)
    return f"between ({lo}) and ({hi})"


def _repairs(solid: Solid) -> list[str]:
    repaired, out = solid.repaired, []
    if solid.flipped > WORTH_A_LINE:
        out.append(f"{percent(solid.flipped)} of the surface faced inward and was turned round")
    doubled = solid.areas[repaired.doubled].sum() / solid.areas.sum()
    if doubled > WORTH_A_LINE:
        out.append(f"{percent(doubled)} of the surface was given in both orientations and is taken once")
    if repaired.repeated:
        out.append(f"{repaired.repeated} faces were copies of others and were left out")
    if repaired.dropped_pairs:
        out.append(f"{repaired.dropped_pairs} pairs of opposite faces (walls between parts, flaps) were left out")
    return out
