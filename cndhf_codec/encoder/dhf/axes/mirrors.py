"""Find mirror planes of a solid: a height field along an axis within one needs to store only half of its heights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....arrays import F64
from ....errors import require
from ....format.constants import BOX_STEP
from ....mesh.distances import point_distances
from ....mesh.solid import Solid
from ..frames import Frame, frame_for_axis, frame_for_quaternion

# Evidence for these constants: ADR 006.
MOST_ERROR = 3e-4  # most mean distance of the surface from its image in a mirror plane (normalised units)
MIRRORED_POINTS = 20_000
SPACING = 1.5  # samples of the image may be so many times as far from those of the surface as these from each other
SQUARE = 0.01  # most cosine between planes at right angles


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """A mirror plane, the points p of the normalised frame with normal . p = offset. error: mean distance of the
    surface from its mirror image."""

    normal: F64
    offset: float
    error: float


def mirror_planes(solid: Solid, seed: int) -> list[MirrorPlane]:
    """Find planes in which the solid is its own mirror image, exactly or nearly. They are at right angles to each
    other; the one of least error comes first.

    Such a plane goes through the centroid of the surface, and its normal is a principal axis of the surface's second
    moments. Where two moments are equal, their axes are arbitrary, so coordinate axes are tried, too.
    """
    centroid, axes = _moments(solid)
    rng = np.random.default_rng(seed)
    points, others = (solid.sample(MIRRORED_POINTS, rng)[0] for _ in range(2))
    tree = require("scipy.spatial", "encode").cKDTree(points)
    spacing = float(tree.query(others)[0].mean())
    found = []
    for normal in (*np.eye(3), *axes):
        offset = float(normal @ centroid)
        image = others - 2 * (others @ normal - offset)[:, None] * normal
        if tree.query(image)[0].mean() <= SPACING * spacing + MOST_ERROR:
            error = float(point_distances(image, solid.vertices, solid.faces).mean())
            if error <= MOST_ERROR:
                found.append(MirrorPlane(normal, offset, error))
    chosen: list[MirrorPlane] = []
    for plane in sorted(found, key=lambda p: p.error):
        if all(abs(plane.normal @ other.normal) < SQUARE for other in chosen):
            chosen.append(plane)
    return chosen


def frame_with_mirrors(axis: F64, vertices: F64, planes: list[MirrorPlane]) -> Frame:
    """Make a frame as `frame_for_axis`, but with u and v across the planes that hold the axis, and mirrored there."""
    across = [p for p in planes if abs(p.normal @ axis) < 1e-9][:2]
    if not across:
        return frame_for_axis(axis, vertices)
    u = across[0].normal
    rotation = np.stack([u, np.cross(axis, u), axis])
    transform = require("scipy.spatial.transform", "encode").Rotation.from_matrix(rotation)
    frame = frame_for_quaternion(transform.as_quat(), vertices)
    lo, hi = list(frame.box[0::2]), list(frame.box[1::2])
    for k, plane in enumerate(across):
        # The plane is the middle of the box, to half a step.
        twice = round(2 * plane.offset * float(rotation[k] @ plane.normal) / BOX_STEP)
        hi[k] = max(hi[k], twice - lo[k])
        lo[k] = twice - hi[k]
    return Frame(frame.quaternion, (lo[0], hi[0], lo[1], hi[1], lo[2], hi[2]), 2 ** len(across) - 1)


def _moments(solid: Solid) -> tuple[F64, F64]:
    """Centroid (3,) of the surface, and the principal axes of its second moments, (3, 3) in rows."""
    corners = solid.vertices[solid.faces]
    total = corners.sum(axis=1)
    weights = solid.areas / solid.areas.sum()
    centroid = weights @ total / 3
    # The mean of x x^T over a triangle is that of its corners and three times its centre.
    squares = np.einsum("n,nki,nkj->ij", weights, corners, corners) + np.einsum("n,ni,nj->ij", weights, total, total)
    return centroid, np.linalg.eigh(squares / 12 - np.outer(centroid, centroid))[1].T
