"""Draw meshes by orthographic ray casting: shading, and the points that each pixel sees."""

from __future__ import annotations

import numpy as np

from ..arrays import F64, I32
from ..mesh.solid import Solid

LIGHT = np.array([0.3, 0.4, 0.87])
WARM = np.array([0.93, 0.86, 0.76])


def view_frame(azimuth: float, elevation: float, up: str = "y") -> F64:
    """Frame of a view, (3, 3): rows right, up, towards the eye. Angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    right = np.array([np.cos(a), 0, -np.sin(a)])
    frame = np.stack([right, np.cross(eye, right), eye])
    return frame if up == "y" else frame[:, [2, 0, 1]]


def visible(solid: Solid, frame: F64, size: int) -> tuple[I32, F64]:
    """Find what each pixel of a (size, size) picture of the unit ball sees.

    Returns the face (size * size,), -1 for none, and the point of it that is seen (size * size, 3).
    """
    side = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(side, -side)
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1) @ frame
    face = solid.first_hits(origins, -frame[2])
    # Intersect the ray with the face's plane. A face may be seen edge-on, so the divisor needs a least magnitude.
    normal, corner = solid.normals[face], solid.vertices[solid.faces[face, 0]]
    across = -normal @ frame[2]
    across = np.where(np.abs(across) < 1e-9, 1e-9, across)
    t = np.einsum("ij,ij->i", corner - origins, normal) / across
    return face, origins - np.clip(t, 0, 4)[:, None] * frame[2]


def picture(solid: Solid, frame: F64, size: int) -> F64:
    """Draw the unit ball: (size, size, 3) colours."""
    return shade(solid, frame, visible(solid, frame, size)[0]).reshape(size, size, 3)


def shade(solid: Solid, frame: F64, face: I32) -> F64:
    """Shade pixels that see `face` (N,): (N, 3) colours, white where the face is -1."""
    normals = solid.normals[face] @ frame.T
    normals *= np.where(normals[:, 2:] < 0, -1, 1)  # an open surface is seen from both sides
    lambert = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1) * 0.8 + 0.2 * normals[:, 2].clip(0, 1)
    return np.where(face[:, None] >= 0, lambert[:, None] * WARM, 1.0)
