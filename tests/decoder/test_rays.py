"""Rays against shapes known in closed form, and against embree on a fine mesh."""

from __future__ import annotations

import analytic
import numpy as np
import pytest
import trimesh
from analytic import ABOUT_Y_90, slab, waves

from cndhf_codec import load
from cndhf_codec.decoder.dhf import rays
from cndhf_codec.errors import OptionError

LO, HI = np.array([-0.5, -0.25, -0.125]), np.array([0.25, 0.5, 0.375])


def box_hits(origins, directions):
    """Distances of first crossings with the box LO, HI; unit directions."""
    a, b = (LO - origins) / directions, (HI - origins) / directions
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    distance = np.where(enter > 0, enter, leave)
    return np.where((enter < leave) & (leave > 0), distance, np.inf), leave - enter


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize(("centre", "scale"), [((0, 0, 0), 1.0), ((1e6, -2e6, 3e6), 40.0)])
def test_a_box(centre, scale):
    rng = np.random.default_rng(0)
    origins = rng.uniform(-2, 2, (3000, 3))
    directions = unit(rng.uniform(-0.5, 0.5, (3000, 3)) - origins)
    expected, chord = box_hits(origins, directions)
    model = analytic.model(slab(LO, HI), centre=centre, scale=scale)
    hits = model.ray_intersect(origins * scale + centre, directions * rng.uniform(0.01, 100, (3000, 1)))
    assert (chord[np.isinf(hits.distance) & np.isfinite(expected)] < 1e-3).all()  # a corner cut off may be missed
    assert not (np.isfinite(hits.distance) & np.isinf(expected)).any()
    hit = np.isfinite(hits.distance)
    assert hit.mean() > 0.3
    points = (hits.point[hit] - centre) / scale
    off = np.abs(np.maximum(LO - points, points - HI).max(axis=1))
    assert off.max() < 2e-6  # of the surface; along a ray that grazes it more
    assert np.percentile(np.abs(hits.distance[hit] / scale - expected[hit]), 99) < 2e-6
    np.testing.assert_allclose(hits.distance[hit], expected[hit] * scale, atol=2e-5 * scale)
    np.testing.assert_allclose(points, origins[hit] + expected[hit, None] * directions[hit], atol=2e-5)
    on = np.stack([np.abs(points - LO), np.abs(points - HI)], axis=1).reshape(-1, 6)
    face = on.argmin(axis=1)
    normals = np.concatenate([-np.eye(3), np.eye(3)])[face]
    away_from_edges = np.sort(on, axis=1)[:, 1] > 1e-4
    np.testing.assert_allclose(hits.normal[hit][away_from_edges], normals[away_from_edges], atol=1e-5)
    assert np.isnan(hits.point[~hit]).all()
    assert np.isnan(hits.normal[~hit]).all()


def test_from_inside_the_ray_hits_where_it_leaves():
    hits = analytic.model(slab(LO, HI)).ray_intersect([0, 0, 0], [[1, 0, 0], [0, -2, 0], [0, 0, 5]])
    np.testing.assert_allclose(hits.distance, [0.25, 0.25, 0.375], atol=2e-6)
    np.testing.assert_allclose(hits.normal, [[1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-6)


def test_behind_the_origin_is_no_hit():
    hits = analytic.model(slab(LO, HI)).ray_intersect([[2, 0, 0], [-2, 0, 0]], [1, 0, 0])
    assert np.isinf(hits.distance).tolist() == [True, False]


def test_rays_along_faces():
    model = analytic.model(slab((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)))
    hits = model.ray_intersect([[-2, 0.501, 0], [-2, 0.499, 0], [0.4999, -3, 0]], [[1, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert np.isinf(hits.distance[0])
    np.testing.assert_allclose(hits.distance[1:], [1.5, 2.5], atol=1e-5)


def test_a_thin_plate_is_found():
    model = analytic.model(slab((-0.5, -0.5, 0), (0.5, 0.5, 2**-9)))  # a five-hundredth of its length
    xy = np.random.default_rng(0).uniform(-0.49, 0.49, (500, 2))
    hits = model.ray_intersect(np.column_stack([xy, np.full(500, 1.0)]), [0, 0, -1])
    np.testing.assert_allclose(hits.distance, 1 - 2**-9, atol=2e-6)


@pytest.mark.encode
@pytest.mark.parametrize("name", ["waves", "fitted"])
def test_as_embree_on_a_fine_mesh(name, golden):
    model = (
        load(golden / "encoded.cndhf") if name == "fitted" else analytic.model(waves(1, fold=1), waves(2, ABOUT_Y_90))
    )
    mesh = model.to_mesh(256)
    diagonal = np.linalg.norm(mesh.extents)
    rng = np.random.default_rng(0)
    centre = mesh.bounds.mean(axis=0)
    origins = centre + diagonal * unit(rng.normal(size=(3000, 3)))
    origins[:500] = mesh.triangles_center[rng.integers(0, len(mesh.faces), 500)] * 0.5 + centre * 0.5
    directions = rng.uniform(*mesh.bounds, (3000, 3)) - origins
    hits = model.ray_intersect(origins, directions)
    at, ray, face = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    expected = np.full(3000, np.inf)
    expected[ray] = np.linalg.norm(at - origins[ray], axis=1)
    assert (np.isfinite(expected) != np.isfinite(hits.distance)).mean() < 0.004
    both = np.isfinite(expected) & np.isfinite(hits.distance)
    assert both.mean() > 0.3
    off = np.abs(expected[both] - hits.distance[both]) / diagonal
    assert np.median(off) < 1e-4
    assert (off > 2e-3).mean() < 0.01  # rays that graze
    normals = np.full((3000, 3), np.nan)
    normals[ray] = mesh.face_normals[face]
    assert np.median((normals[both] * hits.normal[both]).sum(axis=1)) > 0.999
    # f is along an axis: on steep walls it is many times the distance.
    f, gradient = model.implicit(hits.point[both], gradient=True)
    distance = np.abs(f) / np.linalg.norm(gradient, axis=1)
    assert np.percentile(distance, 99) < 2e-6 * mesh.extents.max()


def test_shapes_and_types():
    model = analytic.model(slab(LO, HI))
    hits = model.ray_intersect([0, 0, 0], [1, 0, 0])
    assert (hits.distance.shape, hits.point.shape, hits.normal.shape) == ((), (3,), (3,))
    assert hits.distance.dtype == hits.point.dtype == hits.normal.dtype == np.float64
    hits = model.ray_intersect(np.zeros((4, 1, 3), np.float32), np.ones((5, 3), np.float32))
    assert hits.distance.shape == (4, 5)
    assert hits.point.shape == hits.normal.shape == (4, 5, 3)
    assert hits.distance.dtype == hits.point.dtype == hits.normal.dtype == np.float32
    assert model.ray_intersect(np.empty((0, 3)), [1, 0, 0]).distance.shape == (0,)
    with pytest.raises(OptionError, match=r"\(\.\.\., 3\)"):
        model.ray_intersect([0, 0], [1, 0, 0])
    with pytest.raises(OptionError, match="broadcast"):
        model.ray_intersect(np.zeros((2, 3)), np.ones((3, 3)))


def test_rays_without_a_direction_or_a_place_miss():
    bad = [[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, -np.inf], [0, np.nan, 0]]
    model = analytic.model(slab(LO, HI))
    assert np.isinf(model.ray_intersect(bad, [1, 0, 0]).distance).all()
    assert np.isinf(model.ray_intersect([0, 0, 0], [*bad, [0, 0, 0]]).distance).all()
    assert np.isfinite(model.ray_intersect([0, 0, 0], [[1e-30, 0, 0], [1e30, 0, 0]]).distance).all()
    assert np.isfinite(model.ray_intersect([0, 0, 0], [[1e-200, 0, 0], [1e200, 1e199, 0]]).distance).all()


def test_an_empty_solid_is_never_hit():
    model = analytic.model(slab((-0.5,) * 3, (-0.25, 0.5, 0.5)), slab((0.25, -0.5, -0.5), (0.5,) * 3))
    assert np.isinf(model.ray_intersect([-2, 0, 0], [[1, 0, 0], [1, 0.1, 0]]).distance).all()


def test_rays_in_several_parts(monkeypatch):
    model = analytic.model(waves(1), waves(2, ABOUT_Y_90))
    rng = np.random.default_rng(0)
    origins = 2 * unit(rng.normal(size=(300, 3)))
    whole = model.ray_intersect(origins, -origins)
    monkeypatch.setattr(rays, "RAYS_AT_ONCE", 64)
    np.testing.assert_allclose(model.ray_intersect(origins, -origins).distance, whole.distance, atol=1e-5)


def test_embree_is_what_trimesh_uses_here():
    assert "embree" in type(trimesh.creation.box().ray).__module__
