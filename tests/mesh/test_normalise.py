"""Normalisation: into the unit ball, and back without loss."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.errors import MeshError
from cndhf_codec.format.writer import _head
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh


@pytest.mark.parametrize("size", [1e-20, 1e-3, 1, 1e9, 1e22])
@pytest.mark.parametrize("offset", [0, 1, 1e6])  # in sizes
def test_the_farthest_vertex_comes_to_the_unit_sphere(size, offset):
    box = trimesh.creation.box((1, 2, 3))
    points = (box.vertices + np.array([offset, -2 * offset, 0])) * size
    n = normalisation(read_mesh((points, box.faces)))
    inside = n.apply(points)
    assert np.linalg.norm(inside, axis=1).max() == pytest.approx(1, rel=1e-6)
    np.testing.assert_allclose(inside.max(axis=0), -inside.min(axis=0), atol=2.0**-9)
    np.testing.assert_allclose(inside * n.scale + n.centre, points, atol=1e-9 * size)


def random_triangles():
    rng = np.random.default_rng(0)
    return [rng.normal(size=(4, 3)) for _ in range(20)]


def test_the_scale_survives_the_file():
    # A float32 scale: what the encoder computes with is what the decoder reads.
    for points in random_triangles():
        scale = normalisation(read_mesh((points, [[0, 1, 2], [0, 2, 3]]))).scale
        assert scale == np.float32(scale)


@pytest.mark.parametrize(("offset", "n_bytes"), [(0.1, 3 * 4), (100.1, 3 * 4), (1e4 + 0.1, 3 * 4), (1e5 + 0.1, 3 * 8)])
def test_the_centre_survives_the_file(offset, n_bytes):
    # Of float32, unless the shape is so far away that it would no longer be in the middle.
    box = trimesh.creation.box((1, 2, 3))
    centre = normalisation(read_mesh((box.vertices + offset, box.faces))).centre
    assert centre == pytest.approx((offset,) * 3, abs=1.5 * 2.0**-10)
    assert len(_head(centre, 1.0)) == 10 + n_bytes


def test_no_vertex_leaves_the_unit_ball():
    for points in random_triangles():
        n = normalisation(read_mesh((points, [[0, 1, 2], [0, 2, 3]])))
        assert np.linalg.norm(n.apply(points), axis=1).max() <= 1


@pytest.mark.parametrize("size", [1e-40, 1e40])
def test_sizes_that_no_float32_can_hold(size):
    box = trimesh.creation.box()
    with pytest.raises(MeshError, match="size"):
        normalisation(read_mesh((box.vertices * size, box.faces)))
