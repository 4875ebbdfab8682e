"""Nearest points and signed distances of triangle meshes, against brute force and libigl."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import trimesh
from triangle_meshes import MESHES, Mesh, box, distances, points_around, rotated, sphere, winding_numbers

from cndhf_codec.decoder import parallel
from cndhf_codec.decoder.queries import TriangleQueries, tree, triangles
from cndhf_codec.decoder.queries.single import Triangles

ROUNDING = 1e-14  # for coordinates of about 1


@pytest.mark.parametrize("name", MESHES)
def test_as_by_brute_force(name):
    mesh = MESHES[name]()
    points = points_around(mesh, 100)
    found = TriangleQueries(*mesh).nearest(points)
    # In triangles that are thousands of times as long as wide, brute force loses digits.
    rounding = 1e-12 if "plate" in name else 1e-9 if "splinters" in name else ROUNDING
    np.testing.assert_allclose(found.distance, distances(mesh, points), atol=rounding)
    # The point is at that distance, and on that face.
    np.testing.assert_allclose(np.linalg.norm(found.point - points, axis=1), found.distance, rtol=1e-12, atol=ROUNDING)
    for face in np.unique(found.face)[:50]:
        at = found.face == face
        assert distances(type(mesh)(mesh.vertices, mesh.faces[[face]]), found.point[at]).max() < rounding


@pytest.mark.parametrize("name", MESHES)
def test_the_sign_is_that_of_contains(name):
    mesh = MESHES[name]()
    points = points_around(mesh, 30)
    queries = TriangleQueries(*mesh)
    signed = queries.distance(points)
    np.testing.assert_array_equal(np.abs(signed), queries.nearest(points).distance)
    off = np.abs(signed) > 1e-11
    np.testing.assert_array_equal(signed[off] > 0, winding_numbers(mesh, points)[off] > 0)


@pytest.mark.parametrize(
    ("name", "rounding"), [("turned plate", 1e-15), ("splinters", 2e-12), ("turned splinters", 2e-12)]
)
def test_thin_triangles_lose_no_digits(name, rounding):
    mesh = MESHES[name]()
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], len(mesh.faces))
    on = (mesh.vertices[mesh.faces] * weights[:, :, None]).sum(axis=1)
    assert TriangleQueries(*mesh).nearest(on).distance.max() < rounding


def test_triangles_that_are_lines_but_for_rounding():
    rng = np.random.default_rng(0)
    a, b, p = rng.normal(size=(3, 3000, 3))
    c = a + rng.uniform(-0.5, 1.5, (3000, 1)) * (b - a)
    feet = Triangles(np.stack([a, b, c]).transpose(0, 2, 1)).feet(np.arange(3000), p.T)
    ends = [distances(Mesh(np.stack(t), np.array([[0, 1, 2]])), q[None])[0] for *t, q in zip(a, b, c, p, strict=True)]
    np.testing.assert_allclose(np.sqrt(feet.squared), ends, rtol=1e-12)


def test_shapes_known_in_closed_form():
    rng = np.random.default_rng(0)
    points = rng.uniform(-2, 2, (2000, 3))
    lo, hi = np.array([-0.5, -0.25, -0.75]), np.array([0.5, 0.25, 0.75])
    outside = np.linalg.norm(np.maximum(np.maximum(lo - points, points - hi), 0), axis=1)
    inside = np.minimum(points - lo, hi - points).min(axis=1)
    expected = np.where(inside > 0, inside, -outside)
    np.testing.assert_allclose(TriangleQueries(*box(lo, hi)).distance(points), expected, atol=1e-14)
    radius = np.linalg.norm(points, axis=1)
    off = TriangleQueries(*sphere(0.8, 5)).distance(points) - (0.8 - radius)
    assert off.max() <= 1e-14  # the faces are within the sphere
    assert off.min() > -0.8 * 6e-4


@pytest.mark.parametrize("distance", [1e3, 1e6, 1e100])
def test_far_away(distance):
    mesh = rotated(box([-0.5] * 3, [0.5] * 3))
    directions = np.random.default_rng(0).normal(size=(200, 3))
    points = directions / np.linalg.norm(directions, axis=1, keepdims=True) * distance
    found = TriangleQueries(*mesh).distance(points)
    np.testing.assert_allclose(found, -distances(mesh, points), rtol=1e-14)


def test_all_triangles_equally_near():
    mesh = sphere(0.8, 4)
    found = TriangleQueries(*mesh).nearest(np.zeros((100, 3)))
    np.testing.assert_allclose(found.distance, distances(mesh, np.zeros((1, 3)))[0], rtol=1e-14)


def test_what_is_not_finite_has_no_nearest_point():
    points = np.array([[np.nan, 0, 0], [0, 1e200, 0], [0, 0, -np.inf], [np.inf, np.nan, 0], [0, 0, 0.5]])
    queries = TriangleQueries(*box([-1] * 3, [1] * 3))
    found = queries.nearest(points)
    np.testing.assert_array_equal(found.distance, [np.nan, np.inf, np.inf, np.nan, 0.5])
    assert (found.face[:4] == -1).all()
    assert np.isnan(found.point[:4]).all()
    np.testing.assert_array_equal(queries.distance(points), [np.nan, -np.inf, -np.inf, np.nan, 0.5])
    assert queries.nearest(np.empty((0, 3))).point.shape == (0, 3)
    none = TriangleQueries(np.empty((0, 3)), np.empty((0, 3), np.int64))
    assert none.nearest(points).face.tolist() == [-1] * 5
    assert none.distance(points[4:]).tolist() == [-np.inf]


def test_an_open_mesh():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    sheet = TriangleQueries(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    found = sheet.nearest(np.array([[0.75, 0.5, 0.5], [0.25, 0.5, -2], [2, 0.5, 0]]))
    np.testing.assert_allclose(found.distance, [0.5, 2, 1])
    np.testing.assert_allclose(found.point, [[0.75, 0.5, 0], [0.25, 0.5, 0], [1, 0.5, 0]])
    assert found.face.tolist() == [0, 1, 0]


def test_pieces_and_threads_change_nothing(monkeypatch):
    mesh = MESHES["torus"]()
    points = points_around(mesh, 300)
    whole = TriangleQueries(*mesh).nearest(points)
    monkeypatch.setattr(triangles, "NEAREST_AT_ONCE", 300)
    monkeypatch.setattr(tree, "PAIRS_AT_ONCE", 100)
    monkeypatch.setattr(parallel, "processors", lambda: 4)
    for part, all_at_once in zip(TriangleQueries(*mesh).nearest(points), whole, strict=True):
        np.testing.assert_allclose(part, all_at_once, atol=1e-15)


def test_memory_is_bounded():
    queries = TriangleQueries(*sphere(0.8, 4))
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-1, 1, (2**16, 3)), rng.normal(size=(200, 3)) * 1e-9])
    queries.nearest(points[:1])
    tracemalloc.start()
    try:
        queries.nearest(points)
        assert tracemalloc.get_traced_memory()[1] < 60e6 * max(2, parallel.processors())
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["fertility", "vase-goblet", "centauro-wheel"])
def test_the_corpus_as_libigl(name, corpus):
    igl = pytest.importorskip("igl")
    mesh = trimesh.load(corpus / f"{name}.ply", force="mesh")
    vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    vertices /= np.linalg.norm(vertices, axis=1).max()
    rng = np.random.default_rng(0)
    on = vertices[faces[rng.integers(len(faces), size=3000)]].mean(axis=1)
    points = np.concatenate([rng.uniform(-1, 1, (1000, 3)), on, on + rng.normal(size=on.shape) * 1e-3])
    squared = igl.point_mesh_squared_distance(points, vertices, faces)[0]
    found = TriangleQueries(vertices, faces).nearest(points)
    np.testing.assert_allclose(found.distance, np.sqrt(squared), atol=1e-11)  # libigl is off by 1.4e-12
