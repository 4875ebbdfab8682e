"""The surface that is fitted, and samples of it."""

from __future__ import annotations

from copy import copy

import numpy as np

from ...arrays import F64, I64
from ...mesh.sampling import area_normals, cover_evenly
from .nearest import Tree


class Target(Tree):
    """The input's surface in the normalised frame, with samples that cover it evenly.

    samples: (K, 3). normals: (K, 3) unit normals of the faces that they lie on. face_normals: (M, 3).
    """

    def __init__(self, vertices: F64, faces: I64, n_samples: int, seed: int) -> None:
        super().__init__(vertices, faces)
        cross = area_normals(vertices, faces)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        self.face_normals = cross / np.where(length > 0, length, 1)
        # In the tree's order neighbours follow each other; a seed begins elsewhere in it.
        order = np.roll(self.order, np.random.default_rng(seed).integers(len(faces)))
        at, places = cover_evenly(vertices, faces[order], n_samples)
        drawn = order[at]
        self.samples = np.einsum("nk,nkd->nd", places, vertices[faces[drawn]])
        self.normals = self.face_normals[drawn]

    def every(self, n: int) -> Target:
        """The same surface with every nth sample."""
        few = copy(self)
        # Compiled functions would be compiled again for what lies in memory otherwise.
        few.samples, few.normals = self.samples[::n].copy(), self.normals[::n].copy()
        return few
