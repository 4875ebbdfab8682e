"""The normalised frame: the centre of the bounding box is the origin, the farthest vertex has distance 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import F64
from .read import Mesh


@dataclass(frozen=True)
class Normalisation:
    """Map to the normalised frame: normalised = (input - centre) / scale.

    The scale is a float32 value, as the file stores it.
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
    centre = mesh.vertices.min(axis=0) / 2 + mesh.vertices.max(axis=0) / 2
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    scale = np.float32(radius)
    if float(scale) < radius:  # never let a vertex fall outside the unit ball
        scale = np.nextafter(scale, np.float32(np.inf))
    return Normalisation((float(centre[0]), float(centre[1]), float(centre[2])), float(scale))
