"""Surface distances of shapes whose distance is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.mesh.distances import Distances, sample_surface, surface_distances


def distances(a: trimesh.Trimesh, b: trimesh.Trimesh, samples: int = 5000) -> Distances:
    arrays = [np.ascontiguousarray(x) for m in (a, b) for x in (m.vertices, m.faces)]
    return surface_distances(*arrays, seed=0, samples=samples)


def test_a_shape_and_itself():
    sphere = trimesh.creation.icosphere(3)
    d = distances(sphere, sphere)
    assert d.maximum < 1e-7


def test_two_concentric_spheres():
    d = distances(trimesh.creation.icosphere(5, 1.0), trimesh.creation.icosphere(5, 1.05))
    assert d.mean == pytest.approx(0.05, rel=0.02)
    assert d.p99 == pytest.approx(0.05, rel=0.03)
    assert d.maximum == pytest.approx(0.05, rel=0.03)


def test_shifted_boxes():
    a, b = trimesh.creation.box(), trimesh.creation.box()
    b.apply_translation([0.1, 0, 0])
    d = distances(a, b)
    # Mean distance of each face: 0.1 of the one outside the other box; of the one inside it min(0.1, distance
    # to a side), whose mean is the integral of (1 - 2 t)^2 to 0.1; 0.1^2 / 2 of the four sides.
    assert d.mean == pytest.approx((0.1 + 0.0813333 + 4 * 0.005) / 6, rel=0.03)
    assert d.maximum == pytest.approx(0.1, rel=1e-3)


def test_a_piece_that_only_one_surface_has_is_seen_in_both_orders():
    a = trimesh.creation.icosphere(3, 0.1)
    b = a.copy()
    b.apply_translation([1, 0, 0])
    both = trimesh.util.concatenate([a, b])
    assert distances(a, both).maximum > 0.8
    assert distances(both, a).maximum == pytest.approx(distances(a, both).maximum, rel=0.01)
    # Half the samples of one direction are about 0.9 away, none of the other: a quarter of that.
    assert distances(a, both).mean == pytest.approx(0.25 * 0.9, rel=0.05)


def test_samples_are_uniform_by_area():
    # Two triangles, one with three times the area of the other.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 1, 0]])
    points = sample_surface(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 4000, 0)
    assert (points[:, 0] > 2).mean() == pytest.approx(0.75, abs=0.03)
    assert np.array_equal(points, sample_surface(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 4000, 0))


def test_scaled():
    assert Distances(1, 2, 3).scaled(2) == Distances(2, 4, 6)
