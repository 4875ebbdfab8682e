"""Height targets of a sphere, an open bowl and planes, and the frames they live in."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.encoder.dhf.fit.targets import height_targets
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.mesh.solid import Solid

RADIUS = 0.8


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    return Solid(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def sphere() -> Solid:
    return solid_of(trimesh.creation.icosphere(5, RADIUS))


AXES = [
    [0, 0, 1],
    [0, 0, -1],
    [1, 0, 0],
    [0, -1, 0],
    [1e-9, 0, -1],
    [0, 1e-4, -1],
    *np.random.default_rng(0).normal(size=(8, 3)),
]


@pytest.mark.parametrize("axis", AXES)
def test_the_frame_takes_the_axis_to_z(axis):
    axis = np.array(axis) / np.linalg.norm(axis)
    vertices = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 3))
    frame = frame_for_axis(axis, vertices)
    np.testing.assert_allclose(frame.rotation @ axis, [0, 0, 1], atol=1e-4)  # int16 quaternion
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)
    assert np.linalg.norm(frame.quaternion) == pytest.approx(32767, abs=2)
    uvz = vertices @ frame.rotation.T
    lo, hi = frame.bounds.T
    assert (lo <= uvz.min(axis=0)).all()
    assert (hi >= uvz.max(axis=0)).all()
    np.testing.assert_allclose(lo, uvz.min(axis=0), atol=2**-14)
    np.testing.assert_allclose(hi, uvz.max(axis=0), atol=2**-14)


def test_coordinate_axes_are_exact():
    vertices = np.eye(3)
    assert np.array_equal(frame_for_axis(np.array([0.0, 0, 1]), vertices).rotation, np.eye(3))
    assert np.array_equal(frame_for_axis(np.array([0.0, 0, -1]), vertices).rotation, np.diag([1, -1, -1]))
    assert np.array_equal(frame_for_axis(np.array([1.0, 0, 0]), vertices).rotation @ [1, 0, 0], [0, 0, 1])


def test_a_flat_shape_still_has_a_box():
    lo, hi = frame_for_axis(np.array([0.0, 0, 1]), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])).bounds.T
    assert (lo < hi).all()


@pytest.mark.parametrize("axis", [[0, 0, 1], [0, 0, -1], [0.3, -0.5, 0.2]])
def test_heights_of_a_sphere(axis):
    solid = sphere()
    t = height_targets(solid, frame_for_axis(np.array(axis), solid.vertices), 64)
    r2 = (t.uv.astype(np.float64) ** 2).sum(axis=-1)
    inside = r2 < (RADIUS - 0.01) ** 2
    assert t.hit[inside].all()
    assert not t.hit[r2 > RADIUS**2].any()
    z = np.sqrt(RADIUS**2 - r2, where=inside, out=np.zeros_like(r2))
    steep = inside & (r2 > (0.9 * RADIUS) ** 2)  # near the rim the facets are seen edge on
    np.testing.assert_allclose(t.far[inside & ~steep], z[inside & ~steep], atol=2e-3)
    np.testing.assert_allclose(t.near[inside & ~steep], -z[inside & ~steep], atol=2e-3)
    assert t.near_known[inside].all()
    assert t.far_known[inside].all()
    assert not t.near_known[~t.hit].any()
    assert t.unknown == 0


def test_the_grid_fills_the_box_with_pixel_centres():
    box = solid_of(trimesh.creation.box((1, 0.5, 0.25)))
    t = height_targets(box, frame_for_axis(np.array([0.0, 0, 1]), box.vertices), 40)
    assert t.hit.shape == (40, 20)
    assert t.hit.all()
    np.testing.assert_allclose(t.uv[0, 0], [-0.5 + 0.0125, -0.25 + 0.0125], atol=1e-6)
    np.testing.assert_allclose(t.uv[1, 0] - t.uv[0, 0], [0.025, 0], atol=1e-6)
    np.testing.assert_allclose(t.near, -0.125, atol=1e-6)
    np.testing.assert_allclose(t.far, 0.125, atol=1e-6)


def test_a_ray_through_a_hole_is_unknown_on_that_side_only():
    # A bowl: the upper part of a sphere is missing, so that rays from above meet its inside.
    whole = trimesh.creation.icosphere(5, RADIUS)
    bowl = trimesh.Trimesh(whole.vertices, whole.faces[whole.triangles_center[:, 2] < 0.3], process=False)
    bowl.remove_unreferenced_vertices()
    solid = solid_of(bowl)
    # As wide as the sphere's equator; the hole in its middle.
    t = height_targets(solid, frame_for_axis(np.array([0.0, 0, 1]), solid.vertices), 64)
    r = np.linalg.norm(t.uv, axis=-1)
    hole, wall = r < 0.7, (r > 0.76) & (r < 0.78)
    assert t.hit[hole].all()
    assert t.near_known[hole].all()
    assert not t.far_known[hole].any()
    assert t.far_known[wall].all()
    # From the other end the near heights are the unknown ones.
    below = height_targets(solid, frame_for_axis(np.array([0.0, 0, -1]), solid.vertices), 64)
    hole_below = np.linalg.norm(below.uv, axis=-1) < 0.7
    assert below.far_known[hole_below].all()
    assert not below.near_known[hole_below].any()
    assert t.unknown > 0.3
