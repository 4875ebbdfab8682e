"""Occupancy grids out, as .npz."""

from __future__ import annotations

import io
import os

import numpy as np

from ..arrays import F64, Mask
from ..files import write_atomically


def write_grid(
    path: str | os.PathLike[str],
    grid: Mask,
    origin: F64,
    spacing: float,
    overwrite: bool = False,
) -> None:
    """Write arrays `occupancy` (nx, ny, nz) bool, `origin` (3,) and `spacing` (), in input coordinates.

    Node (i, j, k) is at origin + spacing * (i, j, k). Raises OutputError.
    """
    buffer = io.BytesIO()
    np.savez_compressed(buffer, occupancy=grid, origin=origin, spacing=np.float64(spacing))
    write_atomically(path, buffer.getvalue(), overwrite)
