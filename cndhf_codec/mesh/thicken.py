"""Give sheets, which have no inside, a wall: every point within half its thickness of them becomes solid."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from ..arrays import F32, F64, I64
from ..errors import MeshError, require
from .distances import point_distances
from .normalise import Normalisation
from .read import Mesh, checked
from .solid import Solid

LEAST_WALL, MOST_WALL = 0.005, 0.2  # of the bounding box's diagonal
# Evidence for these constants: ADR 002.
CELLS_PER_WALL = 2.5  # grid cells through the wall
BLOCK_CELLS = 4  # along the side of a block; blocks far from the sheets are skipped whole


def check_thickness(thickness: float, diagonal: float, name: str) -> None:
    """Raise MeshError for a wall too thin for a file of this kind to hold, or too thick to leave any shape."""
    if not LEAST_WALL * diagonal <= thickness <= MOST_WALL * diagonal:
        raise MeshError(
            f"{name}: a wall of {thickness:.4g} is {100 * thickness / diagonal:.2g} % of the bounding box's diagonal; "
            f"{100 * LEAST_WALL:g} % to {100 * MOST_WALL:g} % can be made: --thicken {LEAST_WALL * diagonal:.3g} to "
            f"{MOST_WALL * diagonal:.3g}"
        )


def thickened(solid: Solid, norm: Normalisation, thickness: float, name: str) -> Mesh:
    """Replace the sheets of a mesh by a closed wall; the rest stays as it is.

    solid: of the mesh, in the frame of `norm`. thickness: in input units. The wall is the level set of the distance to
    the sheets at half the thickness, by marching cubes.
    """
    measure: Any = require("skimage.measure", "encode")
    corners, numbers = np.unique(solid.faces[solid.sheet], return_inverse=True)
    sheets, faces = solid.vertices[corners], numbers.reshape(-1, 3).astype(np.int64)
    level = thickness / norm.scale / 2
    field, origin, spacing = _distance_grid(sheets, faces, level, 2 * level / CELLS_PER_WALL)
    vertices, wall, _, _ = measure.marching_cubes(field, level=level, gradient_direction="descent")
    vertices = np.concatenate([solid.vertices, vertices.astype(np.float64) * spacing + origin])
    faces = np.concatenate([solid.faces[~solid.sheet], wall + len(solid.vertices)])
    return checked(norm.undo(vertices), faces, name)


def _distance_grid(vertices: F64, faces: I64, reach: float, spacing: float) -> tuple[F32, F64, float]:
    """Measure the distance to faces at the nodes of a grid around them, where it is not much more than `reach`. Returns
    also the position of the first node, and the spacing."""
    origin = vertices.min(axis=0) - reach - 2 * spacing
    blocks = np.ceil((vertices.max(axis=0) + reach + 2 * spacing - origin) / (BLOCK_CELLS * spacing)).astype(int)
    side = BLOCK_CELLS * spacing
    at = np.stack(np.meshgrid(*map(np.arange, blocks), indexing="ij"), axis=-1).reshape(-1, 3)
    at = at[point_distances(origin + (at + 0.5) * side, vertices, faces) < reach + spacing + side * np.sqrt(3) / 2]
    field = np.full(blocks * BLOCK_CELLS, 2 * reach + 4 * spacing, dtype=np.float32)
    nodes = (at[:, None] * BLOCK_CELLS + np.array(list(product(range(BLOCK_CELLS), repeat=3)))).reshape(-1, 3)
    field[tuple(nodes.T)] = point_distances(origin + nodes * spacing, vertices, faces)
    return field, origin, spacing
