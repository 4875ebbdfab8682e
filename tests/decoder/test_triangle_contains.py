"""In or out of triangle meshes, against winding numbers by brute force."""

from __future__ import annotations

import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import triangle_meshes
import trimesh
from triangle_meshes import MESHES, box, joined, points_around, sphere, turned_inside_out, winding_numbers

from cndhf_codec.decoder import parallel
from cndhf_codec.decoder.queries import TriangleQueries, cells, triangles
from cndhf_codec.decoder.queries.cells import CellGrid
from cndhf_codec.decoder.queries.crossings import CrossingTriangles

ON_SURFACE = 1e-11  # where rounding decides; 1e-14 but for the splinters


def agree(mesh, points, answers=None):
    inside = TriangleQueries(*mesh).contains(points) if answers is None else answers
    expected = winding_numbers(mesh, points) > 0
    wrong = np.flatnonzero(inside != expected)
    # Where they differ, the point is on the surface, or so near that the solid angles are not exact.
    return not len(wrong) or TriangleQueries(*mesh).nearest(points[wrong]).distance.max() < ON_SURFACE


@pytest.mark.parametrize("slabs", [False, True])
@pytest.mark.parametrize("name", MESHES)
def test_as_the_winding_number_says(name, slabs, monkeypatch):
    monkeypatch.setattr(cells, "POINTS_WORTH_SLABS", 0 if slabs else 2**60)
    mesh = MESHES[name]()
    assert agree(mesh, points_around(mesh, 300))


@pytest.mark.parametrize("slabs", [False, True])
@pytest.mark.parametrize("name", ["sphere", "turned box", "overlapping boxes", "turned plate"])
def test_on_planes_and_corners_of_cells(name, slabs, monkeypatch):
    monkeypatch.setattr(cells, "POINTS_WORTH_SLABS", 0 if slabs else 2**60)
    mesh = MESHES[name]()
    grid = CellGrid(*mesh)
    rng = np.random.default_rng(0)
    on = mesh.vertices[mesh.faces].mean(axis=1)[rng.integers(len(mesh.faces), size=500)]
    cell = np.rint((on - grid.origin) / grid.edge + rng.uniform(-1, 1, (500, 3)))
    corners = grid.origin + cell * grid.edge
    faces = corners.copy()
    faces[:, :2] += rng.uniform(0, grid.edge, (500, 2))
    for points in (corners, faces, corners + 0.5 * grid.edge):
        for digits in (np.float64, np.float32):
            assert agree(mesh, points.astype(digits).astype(np.float64))


@pytest.mark.parametrize("centre", [(0, 0, 0), (1e4, -2e4, 3e4)])
@pytest.mark.parametrize("scale", [1e-6, 1, 1e6])
def test_anywhere_and_of_any_size(centre, scale):
    mesh = sphere(0.8, 2)
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.9, 0.9, (3000, 3))
    moved = TriangleQueries(mesh.vertices * scale + np.array(centre) * scale, mesh.faces)
    np.testing.assert_array_equal(
        moved.contains((points + centre) * scale), TriangleQueries(*mesh).contains((points + centre) - centre)
    )


@pytest.mark.parametrize("name", MESHES)
def test_lines_cross_a_closed_mesh_zero_times_in_all(name):
    mesh = MESHES[name]()
    crossing = CrossingTriangles(*mesh)
    points = points_around(mesh, 30)
    everything = np.tile(np.arange(len(mesh.faces)), len(points))
    for axis in range(3):
        u, v = (np.repeat(points[:, (axis + k) % 3], len(mesh.faces)) for k in (1, 2))
        covers = crossing.covers(everything, u, v, axis).reshape(len(points), -1)
        assert (covers.sum(axis=1) == 0).all()
        assert name == "one point" or np.abs(covers).sum() > 0


def test_many_large_triangles_get_larger_cells(monkeypatch):
    mesh = triangle_meshes.needles()
    monkeypatch.setattr(cells, "MOST_MEETINGS", 2**13)
    grid = CellGrid(*mesh)
    assert max(grid.shape) <= 35
    points = points_around(mesh, 300)
    assert agree(mesh, points, grid.contains(points))


def test_pieces_and_threads_change_nothing(monkeypatch):
    mesh = MESHES["overlapping boxes"]()
    points = points_around(mesh, 300)
    whole = TriangleQueries(*mesh).contains(points)
    monkeypatch.setattr(triangles, "POINTS_AT_ONCE", 2**9)
    monkeypatch.setattr(cells, "PAIRS_AT_ONCE", 100)
    monkeypatch.setattr(parallel, "processors", lambda: 4)
    np.testing.assert_array_equal(TriangleQueries(*mesh).contains(points), whole)


def test_threads_that_ask_at_once_get_the_same_answers(monkeypatch):
    monkeypatch.setattr(cells, "POINTS_WORTH_SLABS", 3000)  # reached while they ask
    mesh = MESHES["hollow sphere"]()
    points = points_around(mesh, 100)
    expected = TriangleQueries(*mesh).distance(points)
    queries = TriangleQueries(*mesh)
    with ThreadPoolExecutor(6) as pool:
        for found in pool.map(lambda _: queries.distance(points), range(12)):
            np.testing.assert_array_equal(found, expected)


def test_what_is_not_finite_or_far_away_is_outside():
    queries = TriangleQueries(*sphere())
    points = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e6, 0, 0], [0, -1e300, 0], [0, 0, 0]]
    assert queries.contains(np.array(points)).tolist() == [False] * 5 + [True]


def test_no_points_and_no_faces():
    assert TriangleQueries(*sphere()).contains(np.empty((0, 3))).shape == (0,)
    assert not TriangleQueries(np.empty((0, 3)), np.empty((0, 3), np.int64)).contains(np.zeros((2, 3))).any()


def test_parts():
    cavity = joined(box([-1] * 3, [1] * 3), turned_inside_out(box([-0.5] * 3, [0.5] * 3)), box([-0.25] * 3, [0.25] * 3))
    points = np.array([[0.75, 0, 0], [0.4, 0, 0], [0.1, 0, 0], [1.1, 0, 0]])
    assert TriangleQueries(*cavity).contains(points).tolist() == [True, False, True, False]
    assert not TriangleQueries(*turned_inside_out(sphere())).contains(points).any()


def test_memory_is_bounded():
    queries = TriangleQueries(*sphere(0.8, 5))
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2**18, 3))
    points *= (0.8 + rng.normal(size=(2**18, 1)) * 1e-3) / np.linalg.norm(points, axis=1, keepdims=True)
    queries.contains(points)
    tracemalloc.start()
    try:
        queries.contains(points)
        assert tracemalloc.get_traced_memory()[1] < 40e6 * max(2, parallel.processors())
    finally:
        tracemalloc.stop()


@pytest.mark.encode
@pytest.mark.parametrize("name", ["fertility", "vase-goblet", "centauro-wheel"])
def test_the_corpus(name, corpus):
    simplification = pytest.importorskip("fast_simplification")
    whole = trimesh.load(corpus / f"{name}.ply", force="mesh")
    whole.apply_scale(1 / np.linalg.norm(whole.vertices, axis=1).max())
    mesh = trimesh.Trimesh(*simplification.simplify(whole.vertices, whole.faces, target_count=6000))
    if not mesh.is_watertight:  # centauro-wheel, whose parts touch each other
        mesh = whole
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    mesh = triangle_meshes.Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64))
    assert agree(mesh, points_around(mesh, 600000 // len(mesh.faces)))
