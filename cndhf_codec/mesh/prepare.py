"""From a source to the solid that is encoded, with what had to be assumed on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import F64, I64, Mask
from ..encoder.size_search import Length
from ..errors import MeshError, require
from ..format.constants import BOX_STEP
from .normalise import Normalisation, normalisation
from .read import Mesh, checked, read_mesh
from .repair import connected
from .solid import Solid
from .thicken import check_thickness, thickened

MOST_OPEN = 0.25  # of the rays from outside may meet sheets: then the rest is worth having without them
# A mesh of more faces is simplified for the fit: the trees over them would take minutes and gigabytes again and again.
MOST_FACES, SIMPLIFIED = 2_000_000, 1_000_000
# How far behind a sheet a body must reach (normalised units). Measured there, inside: 2 % of a bed's single panel, 90 %
# of a draped cloth, all of an open box.
BEHIND = 0.01
SPECKS = 0.001  # share of the surface up to which parts are specks, all together: less than any error of a file
FAR_AWAY = 2.0  # a frame so many times as large leaves half of the detail
THINNEST = 4 * BOX_STEP  # normalised units: a domain's box is rounded by up to a step at either side
ROUNDING = 0.001  # a smaller share is not worth a line: of rays, a face seen from behind at a silhouette


@dataclass(frozen=True, eq=False)
class Prepared:
    """given: the input, and flipped, the share of its surface whose orientation was reversed. norm: the frame of what
    follows. solid: what is encoded, of a simplified mesh where the input is very large. reference: vertices and faces
    that the error is measured against: the input's, with its walls if it was thickened, without specks far away.
    extents, diagonal: of the input's bounding box, without such specks; input units. assumptions: a line for each thing
    taken for granted. refusal: why there is no solid to encode, with the remedy, or None.
    """

    given: Mesh
    flipped: float
    norm: Normalisation
    solid: Solid
    reference: tuple[F64, I64]
    extents: F64
    diagonal: float
    assumptions: list[str]
    refusal: str | None


def prepare(source: Any, thicken: Length | None = None) -> Prepared:
    """Read a source (see `read_mesh`) and make it a solid; thicken: of the wall that sheets get. Raises InputError, and
    MeshError for what is no mesh or a wall that cannot be made; a surface too open to be a solid, or too thin for a
    file, is a `refusal`."""
    given = read_mesh(source)
    assumptions = list(given.notes)
    if given.dropped:
        assumptions.append(f"{given.dropped} faces of zero area were left out")
    mesh, strays = without_strays(given)
    assumptions += strays
    extents = np.ptp(mesh.vertices, axis=0)
    diagonal = float(np.linalg.norm(extents))
    norm = normalisation(mesh)
    solid = _solid(mesh, norm)
    flipped, refusal = solid.flipped, None
    assumptions += _repairs(solid)
    if len(mesh.faces) > MOST_FACES:
        assumptions.append(
            f"the fit works on {len(solid.given)} faces, simplified from {len(mesh.faces)}; "
            "the error is measured against all of them"
        )
    if thicken is not None:
        thickness = thicken.in_units(diagonal)
        check_thickness(thickness, diagonal, mesh.name)
        if solid.open:
            assumptions.append(
                f"sheets, {percent(solid.open)} of what is seen from outside, got a wall of {thickness:.4g}"
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
                f"sheets without thickness, {percent(share)} of the surface, {_place(solid, norm, bare)}, "
                "were left out; --thicken gives them a wall"
            )
            used, numbers = np.unique(solid.faces[~bare], return_inverse=True)
            kept = checked(solid.vertices[used] * norm.scale + np.array(norm.centre), numbers.reshape(-1, 3), mesh.name)
            # The frame is that of what is kept; the error is measured against what was given.
            given_vertices, norm = reference[0] * norm.scale + np.array(norm.centre), normalisation(kept)
            solid = _solid(kept, norm)
            reference = norm.apply(given_vertices), reference[1]
    if not refusal and solid.behind > ROUNDING:
        assumptions.append(
            f"the surface is open: {percent(solid.behind)} of the rays from outside came in through a hole, "
            "which comes back closed"
        )
    if not refusal and solid.closed:
        # Of a plate it is the thickness, of a rod half of it.
        thickness = 2 * abs(solid.signed_volume) / float(solid.areas.sum())
        if thickness < THINNEST:
            refusal = (
                f"{mesh.name}: it is {thickness * norm.scale:.3g} thick, less than a {1 / THINNEST:.0f}th of its size: "
                "thinner than a file can tell; thicken it"
            )
    return Prepared(given, flipped, norm, solid, reference, extents, diagonal, assumptions, refusal)


def percent(share: float) -> str:
    """A share in words that do not make nothing of little."""
    return "under 0.1 %" if 0 < share < 0.001 else f"{100 * share:.1f} %"


def counted(number: int, word: str = "part") -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def without_strays(mesh: Mesh) -> tuple[Mesh, list[str]]:
    """The mesh without what is far away and next to nothing, and a line that names it.

    The frame reaches to the farthest vertex, and what a file can tell is a share of it: specks that make the frame
    FAR_AWAY times as large take as much of the detail of everything else.
    """
    component = connected(mesh.faces[:, :2].ravel(), mesh.faces[:, 1:].ravel(), len(mesh.vertices))
    count = int(component.max()) + 1
    if count == 1:
        return mesh, []
    of_face = component[mesh.faces[:, 0]]
    order = np.argsort(component, kind="stable")
    starts = np.flatnonzero(np.diff(component[order], prepend=-1))
    lo, hi = (f.reduceat(mesh.vertices[order], starts) for f in (np.minimum, np.maximum))
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas = np.bincount(of_face, weights=np.linalg.norm(np.cross(b - a, c - a), axis=1), minlength=count)
    by_area = np.argsort(areas, kind="stable")
    small = np.zeros(count, dtype=bool)
    small[by_area[np.cumsum(areas[by_area]) <= SPECKS * areas.sum()]] = True
    # What is large, and the small parts about it, which widen its box to no more than FAR_AWAY times.
    low, high = lo[~small].min(axis=0), hi[~small].max(axis=0)
    middle, reach = low / 2 + high / 2, FAR_AWAY * float(np.linalg.norm(high - low)) / 2
    away = small & (np.linalg.norm(np.maximum(hi - middle, middle - lo), axis=1) > reach)
    if not away.any():
        return mesh, []
    faces = away[of_face]
    at = (lo[away] / 2 + hi[away] / 2)[0]
    where = f"at about ({at[0]:.4g}, {at[1]:.4g}, {at[2]:.4g})" + (" and elsewhere" if away.sum() > 1 else "")
    kept = checked(mesh.vertices, mesh.faces[~faces], mesh.name)
    return kept, [
        f"{counted(int(away.sum()), 'tiny part')} far away ({counted(int(faces.sum()), 'face')}, "
        f"{percent(areas[away].sum() / areas.sum())} of the surface, {where}) left out, of the errors too: to reach so "
        "far would cost everything else its detail"
    ]


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


def _bare(solid: Solid) -> Mask:
    """(M,) faces of sheets that nothing closes to a body: just behind them is outside. To keep them would leave threads
    of them in the fit."""
    at = np.flatnonzero(solid.sheet)
    points = solid.vertices[solid.faces[at]].mean(axis=1) - BEHIND * solid.normals[at]
    patch = solid.repaired.patch
    inside = np.bincount(patch[at], weights=solid.areas[at] * solid.contains(points), minlength=patch.max() + 1)
    whole = np.bincount(patch[at], weights=solid.areas[at], minlength=patch.max() + 1)
    return solid.sheet & (inside < whole / 2)[patch]


def _place(solid: Solid, norm: Normalisation, faces: Mask) -> str:
    """Where some faces are, in input coordinates."""
    corners = solid.vertices[solid.faces[faces]].reshape(-1, 3) * norm.scale + np.array(norm.centre)
    ends = np.stack([corners.min(axis=0), corners.max(axis=0)])
    ends = np.round(ends, 3 - int(np.ceil(np.log10(np.ptp(ends, axis=0).max())))) + 0.0  # thousandths of their size
    lo, hi = (", ".join(f"{x:g}" for x in end) for end in ends)
    return f"between ({lo}) and ({hi})"


def _repairs(solid: Solid) -> list[str]:
    repaired, out = solid.repaired, []
    if solid.flipped > ROUNDING:
        out.append(f"{percent(solid.flipped)} of the surface faced inward and was turned round")
    doubled = solid.areas[repaired.doubled].sum() / solid.areas.sum()
    if doubled > ROUNDING:
        out.append(f"{percent(doubled)} of the surface was given in both orientations and is taken once")
    if repaired.repeated:
        out.append(f"{repaired.repeated} faces were copies of others and were left out")
    if repaired.dropped_pairs:
        out.append(f"{repaired.dropped_pairs} pairs of opposite faces (walls between parts, flaps) were left out")
    return out
