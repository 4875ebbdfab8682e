"""Files that hold surfaces, made by hand: control meshes of known shape."""

from __future__ import annotations

import manifolds
import numpy as np

from cndhf_codec.decoder import Model
from cndhf_codec.format import Container, ControlMesh

NO_TURN = (0, 0, 0, 32767)
STEP = 2.0**-12
OCTAHEDRON = np.array([(4, 0, 1), (4, 1, 2), (4, 2, 3), (4, 3, 0), (5, 1, 0), (5, 2, 1), (5, 3, 2), (5, 0, 3)])
TIPS = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
CUBE = manifolds.voxels(np.ones((1, 1, 1), dtype=bool))
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def edges_of(faces: np.ndarray) -> np.ndarray:
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)


def container(faces: np.ndarray, vertices: np.ndarray, sharp: object = (), **where: object) -> Container:
    """A file of a control mesh; vertices are rounded to multiples of 2^-12. where: centre, scale."""
    placed = {"centre": (0.0, 0.0, 0.0), "scale": 1.0, **where}
    mesh = ControlMesh(
        NO_TURN,
        STEP,
        np.rint(np.asarray(vertices) / STEP).astype(np.int32),
        np.asarray(faces, dtype=np.int32),
        np.asarray(sharp, dtype=np.int32).reshape(-1, 2),
    )
    return Container(**placed, surface=mesh)


def cube(**where: object) -> Model:
    """The cube from -1/2 to 1/2, its edges sharp."""
    return Model(container(CUBE, CORNERS - 0.5, edges_of(CUBE), **where))


def ball(**where: object) -> Model:
    """The limit of an octahedron, which is round but for a few percent."""
    return Model(container(OCTAHEDRON, TIPS, **where))


def capped_tube(n: int = 12) -> Model:
    """A cylinder of radius 1/2 and height 1, but for what a crease of n edges is short of a circle."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / 2
    vertices = [np.column_stack([ring, np.full(n, z)]) for z in (-0.5, 0.5)] + [np.array([(0, 0, -0.5), (0, 0, 0.5)])]
    k, after = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate(
        [
            np.column_stack([k, after, n + after]),
            np.column_stack([k, n + after, n + k]),
            np.column_stack([after, k, np.full(n, 2 * n)]),
            np.column_stack([n + k, n + after, np.full(n, 2 * n + 1)]),
        ]
    )
    rims = np.sort(np.concatenate([np.column_stack([k, after]), n + np.column_stack([k, after])]), axis=1)
    return Model(container(faces, np.concatenate(vertices), rims))


def shell() -> Model:
    """A cube with a cubic cavity from -1/4 to 1/4."""
    faces = manifolds.together(CUBE, CUBE[:, ::-1])
    return Model(container(faces, np.concatenate([CORNERS - 0.5, (CORNERS - 0.5) / 2]), edges_of(faces)))


def sheet(**where: object) -> Model:
    """A wavy sheet over the unit square."""
    x, y = (n / 6 for n in np.divmod(np.arange(49), 7))
    return Model(container(manifolds.grid(6, 6), np.column_stack([x, y, 0.1 * np.sin(6 * x)]), **where))
