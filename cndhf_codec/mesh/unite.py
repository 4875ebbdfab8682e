"""Unite the overlapping parts of a mesh, so that no face lies inside the solid.

Inside is where the winding number is above 1/2, as for double height fields (`solid.py`): each part is closed, and what
it encloses is united with what the others do by manifold3d.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import F64, I64, Mask
from ..errors import MeshError, require
from .bodies import bodies_of_surface, piercing
from .connectivity import component_boxes, face_components
from .holes import without_holes
from .normalise import normalisation
from .prepare import MOST_FACES, WORTH_A_LINE, AsGiven, Prepared, solid_or_error
from .read import Mesh
from .sampling import face_areas
from .solid import Solid, signed_volumes
from .wording import percent

# Distance up to which slivers between nearly equal faces are removed (normalised units). Evidence: ADR 043.
SLIVER = 1e-6


@dataclass(frozen=True)
class United:
    """What uniting did. before, after: numbers of parts that enclose something. volume: after, in cubed input units."""

    before: int
    after: int
    volume: float


def united(prepared: Prepared, seed: int) -> tuple[AsGiven, United]:
    """Replace a mesh by the boundary of the solid that it bounds, without faces inside.

    Raises MeshError for a mesh without an inside, one of too many faces, and one that manifold3d refuses.
    """
    solid, name = solid_or_error(prepared), prepared.given.name
    if len(prepared.mesh.faces) > MOST_FACES:
        raise MeshError(
            f"{name}: it has {len(prepared.mesh.faces)} faces; --solid unites at most {MOST_FACES}: simplify it first"
        )
    vertices, faces = without_holes(solid.vertices, solid.faces)
    areas = face_areas(vertices, faces)
    fans = float(areas[len(solid.faces) :].sum() / areas.sum())
    parts = _parts(vertices, faces)
    vertices, faces = _union(vertices, [faces[part] for part in parts], name)
    bodies = bodies_of_surface(vertices, faces)
    norm, assumptions = prepared.norm, [*prepared.assumptions]
    # Not `checked`, which merges equal positions and drops faces: this surface is closed and two-manifold as it is.
    mesh = Mesh(norm.undo(vertices), faces, name, 0)
    if fans > WORTH_A_LINE:
        assumptions.append(f"what closes holes of the surface is {percent(fans)} of it: flat fans of triangles")
    frame = normalisation(mesh)
    whole = Solid(frame.apply(mesh.vertices), mesh.faces)
    pierced = float(piercing(whole, seed)[1].mean())
    if pierced > WORTH_A_LINE:
        assumptions.append(
            f"parts that overlap themselves stay so: {percent(pierced)} of the edges pierce other faces after uniting"
        )
    made = AsGiven(
        prepared.given,
        mesh,
        prepared.flipped,
        frame,
        whole,
        (whole.vertices, whole.given),
        prepared.extents,
        assumptions,
    )
    return made, United(len(parts), bodies.parts + bodies.minor, bodies.volume * norm.scale**3)


def _parts(vertices: F64, faces: I64) -> list[Mask]:
    """Find the parts of a closed surface that enclose something, as masks (M,): each component that looks outward, with
    the cavities in it."""
    label = face_components(faces, len(vertices))
    volumes = np.bincount(label, weights=signed_volumes(vertices, faces))
    outer = np.flatnonzero(volumes > 0)
    outer = outer[np.argsort(volumes[outer], kind="stable")]
    owner = np.arange(len(volumes))
    lo, hi = component_boxes(vertices, faces, label)
    corner = vertices[faces[np.unique(label, return_index=True)[1], 0]]
    igl: Any = require("igl", "compare")
    for cavity in np.flatnonzero(volumes <= 0):
        # Of the smallest part around it. One in no part encloses nothing.
        owner[cavity] = -1
        for part in outer:
            if (lo[part] > lo[cavity]).any() or (hi[part] < hi[cavity]).any():
                continue
            shell = np.ascontiguousarray(faces[label == part])
            if igl.winding_number(vertices, shell, corner[cavity][None])[0] > 0.5:
                owner[cavity] = part
                break
    return [owner[label] == part for part in np.sort(outer)]


def _union(vertices: F64, parts: list[I64], name: str) -> tuple[F64, I64]:
    """Unite closed surfaces. Raises MeshError."""
    manifold3d: Any = require("manifold3d", "mesh")
    solids = []
    for faces in parts:
        used, numbers = np.unique(faces, return_inverse=True)
        solids.append(manifold3d.Manifold(manifold3d.Mesh64(vertices[used], numbers.reshape(-1, 3).astype(np.uint64))))
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    if whole.status() == manifold3d.Error.NoError and whole.is_empty():
        raise MeshError(f"{name}: its parts enclose nothing; leave --solid out")
    if whole.status() != manifold3d.Error.NoError:
        raise MeshError(
            f"{name}: its parts cannot be united (manifold3d says {whole.status().name}); leave --solid out, or unite "
            "them in a modelling program"
        )
    mesh = whole.simplify(SLIVER).to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)
