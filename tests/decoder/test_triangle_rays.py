"""Rays and triangle meshes: shapes known in closed form, rays at corners and edges, embree."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from triangle_meshes import MESHES, box, points_around, rotated, sphere

from cndhf_codec.decoder.queries import TriangleQueries, tree, triangles

LO, HI = np.array([-0.5, -0.25, -0.125]), np.array([0.25, 0.5, 0.375])


def test_a_box():
    rng = np.random.default_rng(0)
    origins = rng.uniform(-2, 2, (3000, 3))
    directions = rng.uniform(-0.5, 0.5, (3000, 3)) - origins
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    a, b = (LO - origins) / unit, (HI - origins) / unit
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    expected = np.where((enter < leave) & (leave > 0), np.where(enter > 0, enter, leave), np.inf)
    hits = TriangleQueries(*box(LO, HI)).ray_intersect(origins, directions)
    np.testing.assert_allclose(hits.distance, expected, rtol=1e-12)
    hit = np.isfinite(expected)
    assert 0.3 < hit.mean() < 0.95
    np.testing.assert_allclose(hits.point[hit], (origins + expected[:, None] * unit)[hit], atol=1e-12)
    on = np.concatenate([hits.point[hit] - LO, HI - hits.point[hit]], axis=1)
    normals = np.concatenate([-np.eye(3), np.eye(3)])[np.abs(on).argmin(axis=1)]
    np.testing.assert_allclose(hits.normal[hit], normals, atol=1e-12)
    assert np.isnan(hits.point[~hit]).all()
    assert np.isnan(hits.normal[~hit]).all()


def test_from_inside_the_normal_points_along_the_ray():
    hits = TriangleQueries(*box(LO, HI)).ray_intersect(np.zeros((3, 3)), np.diag([1.0, -2, 5]))
    np.testing.assert_allclose(hits.distance, [0.25, 0.25, 0.375])
    np.testing.assert_allclose(hits.normal, [[1, 0, 0], [0, -1, 0], [0, 0, 1]])


@pytest.mark.parametrize("name", ["sphere", "turned box", "torus", "soup"])
def test_no_ray_slips_through_edges_and_corners(name):
    mesh = MESHES[name]()
    corners = mesh.vertices[mesh.faces]
    targets = np.concatenate([mesh.vertices, (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2])
    # From inside: whatever the target, the ray has to leave.
    inside = points_around(mesh, 200)
    queries = TriangleQueries(*mesh)
    inside = inside[queries.distance(inside) > 1e-3]
    rng = np.random.default_rng(0)
    origins = inside[rng.integers(len(inside), size=5000)]
    aims = targets[rng.integers(len(targets), size=5000)] - origins
    hits = queries.ray_intersect(origins, aims)
    assert np.isfinite(hits.distance).all()
    if name in ("sphere", "turned box"):  # elsewhere, a ray may touch the surface from inside and go on
        np.testing.assert_allclose(hits.distance, np.linalg.norm(aims, axis=1))
    assert queries.nearest(hits.point).distance.max() < 1e-14


def test_rays_along_axes_through_corners():
    queries = TriangleQueries(*box([-0.5] * 3, [0.5] * 3))
    origins = np.array([[-2, 0.5, 0.5], [-2, 0.5, 0], [-2, 0.501, 0], [-2, -0.501, 0], [-2, 0, -0.501]])
    hits = queries.ray_intersect(origins, np.array([[1.0, 0, 0]] * 5))
    np.testing.assert_allclose(hits.distance, [1.5, 1.5, np.inf, np.inf, np.inf])


def test_from_far_away():
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = TriangleQueries(*sphere(0.8, 4)).ray_intersect(-1e6 * directions, directions)
    np.testing.assert_allclose(np.linalg.norm(hits.point, axis=1), 0.8, atol=2e-3)
    np.testing.assert_allclose((hits.normal * -directions).sum(axis=1), 1, atol=2e-2)


def test_behind_the_origin_is_no_hit():
    hits = TriangleQueries(*box(LO, HI)).ray_intersect(np.array([[2.0, 0, 0], [-2, 0, 0]]), np.array([[1.0, 0, 0]] * 2))
    assert np.isinf(hits.distance).tolist() == [True, False]


def test_rays_without_a_direction_or_a_place_miss():
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -np.inf], [0, np.nan, 0], [0, 0, 0]])
    queries = TriangleQueries(*box(LO, HI))
    assert np.isinf(queries.ray_intersect(bad[:4], np.ones((4, 3))).distance).all()
    assert np.isinf(queries.ray_intersect(np.zeros((5, 3)), bad).distance).all()
    good = np.array([[1e-200, 0, 0], [1e200, 1e199, 0]])
    assert np.isfinite(queries.ray_intersect(np.zeros((2, 3)), good).distance).all()
    assert queries.ray_intersect(np.empty((0, 3)), np.empty((0, 3))).normal.shape == (0, 3)
    none = TriangleQueries(np.empty((0, 3)), np.empty((0, 3), np.int64))
    assert np.isinf(none.ray_intersect(np.zeros((1, 3)), np.ones((1, 3))).distance).all()


def test_flat_triangles_are_not_hit():
    hits = TriangleQueries(*MESHES["flat triangles"]()).ray_intersect(
        np.zeros((500, 3)), points_around(sphere(), 40)[:500]
    )
    np.testing.assert_allclose(np.linalg.norm(hits.normal, axis=1), 1)


def test_pieces_change_nothing(monkeypatch):
    queries = TriangleQueries(*MESHES["torus"]())
    origins = points_around(MESHES["torus"](), 100)
    whole = queries.ray_intersect(origins, -origins)
    monkeypatch.setattr(triangles, "NEAREST_AT_ONCE", 300)
    monkeypatch.setattr(tree, "PAIRS_AT_ONCE", 100)
    for part, all_at_once in zip(queries.ray_intersect(origins, -origins), whole, strict=True):
        np.testing.assert_array_equal(part, all_at_once)


def test_as_embree():
    pytest.importorskip("embreex")
    mesh = trimesh.Trimesh(*rotated(MESHES["torus"]()), process=False)
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(2000, 3))
    directions = rng.uniform(-0.6, 0.6, (2000, 3)) - origins
    at, ray, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    expected = np.full(2000, np.inf)
    expected[ray] = np.linalg.norm(at - origins[ray], axis=1)
    hits = TriangleQueries(mesh.vertices, mesh.faces).ray_intersect(origins, directions)
    differ = np.isfinite(hits.distance) != np.isfinite(expected)
    assert differ.mean() < 1e-3  # embree computes in float32
    both = np.isfinite(expected) & ~differ
    assert both.mean() > 0.2
    assert (np.abs(hits.distance[both] - expected[both]) > 1e-5).mean() < 1e-3
