"""Small pictures of meshes."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt

from ..arrays import F64, I64
from ..errors import require
from ..mesh.solid import Solid
from .render import picture, view_frame

VIEW = (35.0, 25.0)  # azimuth and elevation, degrees
SIZE = 200  # pixels along the side


def thumbnail(vertices: F64, faces: I64, box: npt.ArrayLike, up: str = "y") -> bytes:
    """Draw a mesh as a PNG.

    vertices: (N, 3). faces: (M, 3). box: (2, 3), the corners of the box that fills the picture, so that two meshes can
    be compared. up: the axis that points up, y or z. Raises MissingExtraError (the `report` extra).
    """
    image = require("matplotlib.image", "report")
    low, high = np.asarray(box, dtype=np.float64)
    radius = 0.51 * max(float(np.linalg.norm(high - low)), 1e-30)
    solid = Solid((vertices - (low + high) / 2) / radius, faces.copy())
    buffer = io.BytesIO()
    image.imsave(buffer, picture(solid, view_frame(*VIEW, up), SIZE), format="png")
    return buffer.getvalue()
