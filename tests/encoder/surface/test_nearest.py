"""Nearest points of meshes, against libigl."""

from __future__ import annotations

import igl
import numba
import numpy as np
import pytest
import trimesh

from cndhf_codec.encoder.surface.nearest import Tree
from cndhf_codec.encoder.surface.threads import compiled_threads


def arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)


MESHES = {
    "one face": (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])),
    "two faces": (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 2]]), np.array([[0, 1, 2], [2, 1, 3]])),
    "box": arrays(trimesh.creation.box()),
    "torus": arrays(trimesh.creation.torus(1, 0.3, major_sections=31, minor_sections=17)),
    "needles": arrays(trimesh.creation.cone(0.01, 5, sections=37)),
    "faces without area": (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 0, 3]])),
}


@pytest.mark.parametrize("name", MESHES)
def test_distances_are_those_of_libigl(name):
    vertices, faces = MESHES[name]
    points = np.random.default_rng(0).normal(size=(3000, 3)) * 1.5
    squared, _, _ = igl.point_mesh_squared_distance(points, vertices, faces)
    found = Tree(vertices, faces).closest(points)
    np.testing.assert_allclose(found.distances, np.sqrt(squared), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.points - points, axis=1), found.distances, atol=1e-12)
    # The point lies in the face that is named.
    for k in range(0, 3000, 100):
        alone = igl.point_mesh_squared_distance(found.points[k : k + 1], vertices, faces[found.faces[k : k + 1]])
        assert np.ravel(alone[0])[0] < 1e-20


def test_points_on_the_surface_and_none():
    tree = Tree(*MESHES["torus"])
    assert tree.closest(tree.vertices).distances.max() < 1e-12
    assert tree.closest(np.zeros((0, 3))).distances.shape == (0,)


def test_an_order_serves_moved_vertices():
    vertices, faces = MESHES["torus"]
    moved = vertices + np.random.default_rng(1).normal(size=vertices.shape) * 0.1
    points = np.random.default_rng(2).normal(size=(500, 3))
    kept = Tree(moved, faces, Tree(vertices, faces).order).closest(points)
    np.testing.assert_allclose(kept.distances, Tree(moved, faces).closest(points).distances, atol=1e-12)


def test_equal_answers_whatever_the_threads():
    # Points on the diagonals of a box: several faces are equally near.
    points = np.linspace(-1, 1, 2001)[:, None] * np.ones(3)
    found = []
    for threads in (1, 2):
        before = numba.get_num_threads()
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
        try:
            found.append(Tree(*MESHES["box"]).closest(points))
        finally:
            numba.set_num_threads(before)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_encode_uses_no_more_threads_than_it_may():
    before = numba.get_num_threads()
    with compiled_threads(1):
        assert numba.get_num_threads() == 1
    with compiled_threads(1000):
        assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS
    assert numba.get_num_threads() == before
