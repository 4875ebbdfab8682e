"""Occupancy grids out, as .npz."""

from __future__ import annotations

import io
import os

import numpy as np

from ..arguments import path_like
from ..arrays import F64, Mask
from ..files import write_atomically


def write_grid(
    path: str | os.PathLike[str],
    grid: Mask,
    origin: F64,
    spacing: float,
    overwrite: bool = False,
) -> None:
    """Write an occupancy grid as the arrays `occupancy`, `origin` and `spacing` of an .npz file.

    Parameters
    ----------
    path : str or path-like
        Where to.
    grid, origin, spacing
        As `Model.occupancy` returns them: node (i, j, k) is at origin + spacing * (i, j, k) in input coordinates.
    overwrite : bool
        Replace a file that exists.

    Raises
    ------
    OptionError
        When it is not a path.
    OutputError
        When the file cannot be written, or exists and may not be overwritten.

    Examples
    --------
    >>> import cndhf_codec, numpy, tempfile
    >>> from cndhf_codec.decoder.gridfile import write_grid
    >>> found = cndhf_codec.load("tests/golden/encoded.cndhf").occupancy(16)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_grid(f"{folder}/bracket.npz", *found)
    ...     numpy.load(f"{folder}/bracket.npz")["occupancy"].shape
    (21, 15, 11)
    """
    buffer = io.BytesIO()
    np.savez_compressed(buffer, occupancy=grid, origin=origin, spacing=np.float64(spacing))
    write_atomically(path_like(path), buffer.getvalue(), overwrite)
