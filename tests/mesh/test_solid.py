"""Rays, inside tests and orientation, on known shapes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.mesh.solid import Solid


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    return Solid(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def signed_volume(solid: Solid) -> float:
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-0.9, 0.9, (3000, 3))


def test_inside_a_box(points):
    solid = solid_of(trimesh.creation.box((1, 0.6, 0.8)))
    # Points within 1e-6 of a face could fall on either side in float32; there are none.
    assert np.array_equal(solid.contains(points), np.all(np.abs(points) < [0.5, 0.3, 0.4], axis=1))


def test_inside_a_sphere(points):
    sphere = trimesh.creation.icosphere(4, 0.7)
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - 0.7) > 0.005
    assert np.array_equal(solid_of(sphere).contains(points)[clear], (radius < 0.7)[clear])


def test_a_closed_hole_is_a_part_of_the_boundary():
    sphere = trimesh.creation.icosphere(5, 0.9)
    whole = solid_of(sphere)
    sphere.update_faces(sphere.triangles_center[:, 2] > -0.72)
    holed = solid_of(sphere)
    heights = np.array([-0.3, -0.1, -0.02, 0.02, 0.1])
    points = np.stack([np.zeros(5), np.zeros(5), heights - 0.72], axis=1)
    np.testing.assert_allclose(holed.distances(points), np.abs(heights), atol=0.01)
    # The faces themselves are as far as the rim. Above the hole all is inside, below it nothing.
    assert (np.linalg.norm(points - (0.54, 0, -0.72), axis=1) > 0.5).all()
    assert holed.contains(points).tolist() == [False, False, False, True, True]
    np.testing.assert_allclose(whole.distances(points), np.abs(0.9 + points[:, 2]), atol=0.005)


def test_first_hits():
    solid = solid_of(trimesh.creation.box((1, 1, 1)))
    origins = [[0.1, 0.2, 2], [0.1, 0.2, -2], [0.7, 0.2, 2]]
    hits = solid.first_hits(np.array(origins), np.array([[0, 0, -1], [0, 0, 1], [0, 0, -1]]))
    assert hits[2] == -1
    np.testing.assert_allclose(solid.normals[hits[:2]], [[0, 0, 1], [0, 0, -1]])


def test_many_rays_are_cast_in_parts(monkeypatch):
    solid = solid_of(trimesh.creation.icosphere(3, 0.7))
    origins = np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * [1, 1, 0] + [0, 0, 2]
    whole = solid.first_hits(origins, [0, 0, -1])
    monkeypatch.setattr("cndhf_codec.mesh.solid.RAYS_AT_ONCE", 17)
    assert np.array_equal(solid.first_hits(origins, [0, 0, -1]), whole)


def test_normals_areas_and_faces_belong_together():
    solid = solid_of(trimesh.creation.icosphere(3, 0.7))
    corners = solid.vertices[solid.faces]
    np.testing.assert_allclose(solid.areas.sum(), 4 * np.pi * 0.49, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1)
    assert np.einsum("ij,ij->i", solid.normals, corners.mean(axis=1)).min() > 0
    assert solid.flipped == 0


def test_an_inverted_mesh_is_turned_round(points):
    box = trimesh.creation.box((1, 0.6, 0.8))
    inverted = box.copy()
    inverted.invert()
    solid = solid_of(inverted)
    assert solid.flipped == pytest.approx(1)
    assert signed_volume(solid) == pytest.approx(0.48)
    assert np.array_equal(solid.contains(points), np.all(np.abs(points) < [0.5, 0.3, 0.4], axis=1))


def test_only_the_inverted_part_is_turned_round():
    good, bad = (trimesh.creation.box((0.4, 0.4, 0.4)) for _ in range(2))
    good.apply_translation([-0.4, 0, 0])
    bad.apply_translation([0.4, 0, 0])
    bad.invert()
    solid = solid_of(trimesh.util.concatenate([good, bad]))
    assert solid.flipped == pytest.approx(0.5)
    assert signed_volume(solid) == pytest.approx(2 * 0.4**3)
