"""The surface that is fitted: closest points, and samples of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...arrays import F64, I64
from ...errors import require
from ...mesh.sampling import draw_faces, face_areas, points_in


class Closest(NamedTuple):
    """distances: (N,). faces: (N,) the face of each closest point. points: (N, 3)."""

    distances: F64
    faces: I64
    points: F64


class Tree:
    """A triangle mesh, ready for closest points."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        igl: Any = require("igl", "compare")
        self.vertices, self.faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces)
        self._tree = igl.AABB()
        self._tree.init(self.vertices, self.faces)

    def closest(self, points: F64) -> Closest:
        """The closest point of the surface to each of points (N, 3)."""
        squared, faces, nearest = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(points))
        return Closest(np.sqrt(squared), np.asarray(faces, dtype=np.int64).ravel(), nearest)


class Target(Tree):
    """The input's surface in the normalised frame, with samples that are uniform by area.

    samples: (K, 3). normals: (K, 3) unit normals of the faces that they lie on. face_normals: (M, 3).
    """

    def __init__(self, vertices: F64, faces: I64, n_samples: int, seed: int) -> None:
        super().__init__(vertices, faces)
        cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        self.face_normals = cross / np.where(length > 0, length, 1)
        rng = np.random.default_rng(seed)
        drawn = draw_faces(face_areas(vertices, faces), n_samples, rng)
        self.samples, self.normals = points_in(vertices[faces[drawn]], rng), self.face_normals[drawn]
