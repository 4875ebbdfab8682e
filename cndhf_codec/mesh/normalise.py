"""The normalised frame: the centre of the bounding box is the origin, the farthest vertex has distance 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import F64
from .read import Mesh

# Of the half extent: where rounding the centre to float32 moves it farther, the file holds a centre of float64, which
# takes 12 bytes more. Evidence: ADR 041.
MOST_SHIFT = 2.0**-10


@dataclass(frozen=True)
class Normalisation:
    """Map to the normalised frame: normalised = (input - centre) / scale.

    Both are values that the file can store: the scale a float32, the centre three float32 or three float64.
    """

    centre: tuple[float, float, float]
    scale: float

    def apply(self, points: F64) -> F64:
        """Map input coordinates to the normalised frame."""
        return (points - np.array(self.centre)) / self.scale

    def undo(self, points: F64) -> F64:
        """Map the normalised frame to input coordinates."""
        return points * self.scale + np.array(self.centre)


def normalisation(mesh: Mesh) -> Normalisation:
    """Find the normalisation of a mesh, whose size fits float32 (`read.check_size`)."""
    middle = mesh.vertices.min(axis=0) / 2 + mesh.vertices.max(axis=0) / 2
    centre = middle.astype(np.float32).astype(np.float64)
    if np.abs(centre - middle).max() > MOST_SHIFT * np.abs(mesh.vertices - middle).max():
        centre = middle
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    scale = np.float32(radius)
    if float(scale) < radius:  # never let a vertex fall outside the unit ball
        scale = np.nextafter(scale, np.float32(np.inf))
    return Normalisation((float(centre[0]), float(centre[1]), float(centre[2])), float(scale))
