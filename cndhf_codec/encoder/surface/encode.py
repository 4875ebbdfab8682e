"""Encode a mesh as a subdivision surface, to a given size."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from ...arrays import F64, I64
from ...errors import EncodeError
from ...format import ControlMesh
from ...format.container import rotation_matrix
from ...format.surface import section
from ..deadline import Deadline
from ..progress import Stage
from .cut import cut
from .frame import turned_frame
from .settings import SurfaceSettings
from .target import Target
from .to_size import BITS_PER_VERTEX, surface_of_size

LEAST_SECTION = 40  # bytes: a tetrahedron takes about so many


class EncodedSurface(NamedTuple):
    """A control mesh and its section. error: mean distance, normalised, at the fit's samples."""

    mesh: ControlMesh
    body: bytes
    error: float


def encode_surface(
    vertices: F64,
    faces: I64,
    settings: SurfaceSettings,
    other_bytes: int,
    seed: int,
    stage: Stage,
    deadline: Deadline,
) -> EncodedSurface:
    """Encode a mesh as it is given: with inner parts, all components, open where it is open.

    vertices: (N, 3) normalised. faces: (M, 3), none of zero area. other_bytes: of the file, besides its section.
    Raises EncodeError where no surface fits into so few bytes.
    """
    size = settings.target_size - other_bytes
    if size < LEAST_SECTION:
        raise EncodeError(f"{settings.target_size} bytes hold no surface; use a larger size")
    stage("simplify", 1)
    turned = turned_frame(vertices, faces)
    if turned:
        vertices = vertices @ rotation_matrix(turned).T
        size -= section.QUATERNION_SIZE
    # With few samples per vertex the surface is fitted to them, and not to what lies between.
    most_vertices = min(8 * size / BITS_PER_VERTEX, len(vertices))
    n_samples = max(settings.samples, round(settings.samples_per_vertex * most_vertices))
    target = Target(vertices, faces, n_samples, seed)
    sized = surface_of_size(cut(vertices, faces), target, size, settings, stage, deadline)
    mesh = sized.mesh
    if turned:
        mesh = replace(mesh, quaternion=turned)
        size += section.QUATERNION_SIZE
    # In its frame, and both ways of coding, one of which the search may have left out.
    body = section.encode_surface(mesh)
    if len(body) > size:
        raise EncodeError(
            f"a surface of {settings.target_size} bytes was not reached: the smallest has "
            f"{len(body) + other_bytes}; use a larger size"
        )
    return EncodedSurface(mesh, body, sized.error)
