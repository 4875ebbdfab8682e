"""Triangles of polygons cover the polygon and nothing else, and use every corner."""

from __future__ import annotations

import numpy as np
import pytest

from cndhf_codec.mesh.formats.common import UnreadableError
from cndhf_codec.mesh.formats.polygons import triangulate

RNG = np.random.default_rng(0)


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(T, 3) twice the area vectors."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def check_covers(vertices: np.ndarray, flat: np.ndarray) -> None:
    """Check one polygon, seen from above in `flat`: triangles turn as it does, and their areas add up to its own."""
    n = len(flat)
    faces, notes = triangulate(vertices, np.arange(n), np.array([n]))
    assert notes == []
    x, y = flat.T
    right = abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))
    each = np.linalg.norm(areas(vertices, faces), axis=1)
    assert each.sum() == pytest.approx(right, rel=1e-6)
    assert len(faces) == n - 2
    # Every corner belongs to a triangle that is not thrown away for having no area.
    assert set(faces[each > 1e-9 * right].ravel()) == set(range(n))


def placed(flat: np.ndarray, turned: bool) -> np.ndarray:
    vertices = np.column_stack([flat, np.zeros(len(flat))])
    if not turned:
        return vertices
    q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    return (vertices @ q.T * 7 + [100, -20, 3]).astype(np.float32).astype(np.float64)


STAR = np.column_stack([f(np.arange(10) * np.pi / 5) * np.where(np.arange(10) % 2, 0.3, 1) for f in (np.cos, np.sin)])
COMB = np.array(
    [(x, y) for k in range(8) for x, y in ((2 * k, 0), (2 * k, 5), (2 * k + 1, 5), (2 * k + 1, 0))]
    + [(15, -1), (0, -1)]
)
SPIRAL = np.array(
    [(r * np.cos(t), r * np.sin(t)) for t, r in zip(np.linspace(0, 12, 60), np.linspace(1, 5, 60), strict=True)]
    + [(r * np.cos(t), r * np.sin(t)) for t, r in zip(np.linspace(12, 0, 60), np.linspace(5.4, 1.4, 60), strict=True)]
)
FLAT_SIDES = np.array([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 3), (2, 3), (0, 3), (0, 2)])
SHAPES = {
    "triangle": np.array([(0, 0), (1, 0), (0, 1)]),
    "arrow": np.array([(0, 0), (2, 1), (0, 2), (0.5, 1)]),
    "star": STAR,
    "comb": COMB,
    "spiral": SPIRAL,
    "corners on straight sides": FLAT_SIDES,
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("backwards", [False, True])
def test_simple_polygons_are_covered(shape, turned, backwards):
    for turn in range(0, len(SHAPES[shape]), max(1, len(SHAPES[shape]) // 7)):
        flat = np.roll(SHAPES[shape].astype(float), turn, axis=0)
        flat = flat[::-1] if backwards else flat
        check_covers(placed(flat, turned), flat * (7 if turned else 1))


@pytest.mark.parametrize("corners", [5, 12, 60, 300])
def test_random_stars(corners):
    for _ in range(10):
        angle = (np.arange(corners) + RNG.uniform(0, 0.9, corners)) / corners * 2 * np.pi
        flat = np.column_stack([np.cos(angle), np.sin(angle)]) * RNG.uniform(0.2, 1, corners)[:, None]
        check_covers(placed(flat, False), flat)


def test_convex_polygons_are_fans_from_their_first_corner():
    angle = np.arange(7) / 7 * 2 * np.pi
    vertices = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    faces, _ = triangulate(vertices, np.arange(7), np.array([7]))
    assert faces.tolist() == [[0, k, k + 1] for k in range(1, 6)]


def test_polygons_of_many_sizes_together():
    vertices = np.concatenate([placed(s.astype(float), True) + 50 * k for k, s in enumerate(SHAPES.values())])
    sizes = np.array([len(s) for s in SHAPES.values()])
    faces, notes = triangulate(vertices, np.arange(sizes.sum()), sizes)
    assert notes == []
    owner = np.repeat(np.arange(len(sizes)), sizes)
    assert (owner[faces] == owner[faces[:, :1]]).all()
    assert len(faces) == (sizes - 2).sum()


def test_a_hole_joined_by_a_bridge():
    # As exporters write a face with a hole: out along a bridge and back on it.
    flat = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], dtype=float)
    vertices = placed(flat, False)
    faces, _ = triangulate(vertices, np.arange(10), np.array([10]))
    assert np.linalg.norm(areas(vertices, faces), axis=1).sum() == pytest.approx(2 * 12)


def test_what_cannot_be_covered_is_told():
    bow_tie = np.array([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 3, 0)], dtype=float)
    assert "1 polygons cross or touch themselves" in triangulate(bow_tie, np.arange(4), np.array([4]))[1][0]
    pentagram = np.array([(np.cos(t), np.sin(t), 0) for t in np.arange(5) * 4 * np.pi / 5])
    assert "cross" in triangulate(pentagram, np.arange(5), np.array([5]))[1][0]
    faces, notes = triangulate(bow_tie, np.array([0, 1, 2, 0, 1, 2]), np.array([2, 3, 1]))
    assert faces.tolist() == [[2, 0, 1]]
    assert notes == ["2 faces of fewer than three corners were left out"]


def test_polygons_without_an_area_do_no_harm():
    line = np.array([(k, 2 * k, 0) for k in range(6)], dtype=float)
    faces, _ = triangulate(line, np.arange(6), np.array([6]))
    assert not areas(line, faces).any()
    point = np.zeros((5, 3))
    triangulate(point, np.arange(5), np.array([5]))


def test_too_many_triangles_are_refused():
    with pytest.raises(UnreadableError, match="comes to 1000000000 triangles"):
        triangulate(np.zeros((3, 3)), np.arange(3), np.array([10**9 + 2]))
