"""Measure a decoded mesh against the input: CD, p99, maximum and the mean angle between normals."""

from __future__ import annotations

import numpy as np

from cndhf_codec.encoder.surface.nearest import Tree
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import Mesh
from cndhf_codec.mesh.sampling import draw_faces, face_areas, points_in

SAMPLES = 200_000  # area-uniform points of each surface


class Reference:
    """An input in its normalised frame, ready to be measured against."""

    def __init__(self, mesh: Mesh) -> None:
        self._norm = normalisation(mesh)
        self._tree = Tree(self._norm.apply(mesh.vertices), mesh.faces)

    def figures(self, mesh: tuple[np.ndarray, np.ndarray], samples: int = SAMPLES) -> dict[str, float]:
        """CD, p99 and max in thousandths; normals in degrees, the mean of both directions."""
        vertices, faces = self._norm.apply(np.asarray(mesh[0], dtype=np.float64)), np.asarray(mesh[1], dtype=np.int64)
        other = Tree(vertices, faces)
        there, turned_there = _directed(self._tree, other, samples)
        back, turned_back = _directed(other, self._tree, samples)
        both = np.concatenate([there, back])
        return {
            "CD": 1e3 * float(there.mean() + back.mean()) / 2,
            "p99": 1e3 * float(np.percentile(both, 99)),
            "max": 1e3 * float(both.max()),
            "normals": float(turned_there + turned_back) / 2,
        }


def _directed(of: Tree, to: Tree, samples: int) -> tuple[np.ndarray, float]:
    """Distances of samples of one surface to the other, and the mean angle between the normals there, in degrees.

    Which way a face looks does not count, for inputs have faces either way.
    """
    rng = np.random.default_rng(0)
    drawn = draw_faces(face_areas(of.vertices, of.faces), samples, rng)
    closest = to.closest(points_in(of.vertices[of.faces[drawn]], rng))
    cosine = np.abs(np.sum(normals_of(of)[drawn] * normals_of(to)[closest.faces], axis=1))
    return closest.distances, float(np.degrees(np.arccos(np.clip(cosine, 0, 1))).mean())


def normals_of(tree: Tree) -> np.ndarray:
    a, b, c = (tree.vertices[tree.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return cross / np.where(length > 0, length, 1)
