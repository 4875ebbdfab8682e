"""Cutting into a two-manifold: the surface stays, what is closed stays closed, and the format takes the result."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from manifolds import KINDS, grid

from cndhf_codec.encoder.surface.cut import Manifold, cut
from cndhf_codec.format.surface.manifold import edges_of, fault


def box(lo, hi) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[lo, hi])


def welded(*parts: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of parts, with one vertex for each place."""
    joined = trimesh.util.concatenate(parts)
    places, names = np.unique(np.round(joined.vertices, 9), axis=0, return_inverse=True)
    return places, names.ravel()[joined.faces]


def checked(vertices: np.ndarray, faces: np.ndarray) -> Manifold:
    """Cut, and check what always holds."""
    given = vertices.copy(), faces.copy()
    out = cut(vertices, faces)
    np.testing.assert_array_equal(vertices, given[0])
    np.testing.assert_array_equal(faces, given[1])
    names = out.faces.astype(np.int32)
    assert fault(names, edges_of(names)) is None
    assert len(out.vertices) == names.max() + 1
    return out


def corners(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 9) the corners of each face in an order that does not depend on numbers, of all faces in such an order."""
    each = np.array([t[np.lexsort(t.T)] for t in vertices[faces]]).reshape(-1, 9)
    return each[np.lexsort(each.T)]


def is_closed(mesh: Manifold) -> bool:
    return bool((edges_of(mesh.faces.astype(np.int32)).n_faces == 2).all())


def n_parts(mesh: Manifold) -> int:
    return len(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).split(only_watertight=False))


AT_AN_EDGE = box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_cubes_that_share_an_edge_stay_closed_in_any_order_of_their_faces(order):
    vertices, faces = welded(*AT_AN_EDGE)
    shared = np.flatnonzero((vertices[:, :2] == 1).all(axis=1))
    at_edge = np.flatnonzero(np.isin(faces, shared).sum(axis=1) == 2)
    assert len(at_edge) == 4
    rest = np.setdiff1d(np.arange(len(faces)), at_edge)
    faces = faces[np.concatenate([at_edge[list(order)], rest])]
    out = checked(vertices, faces)
    assert is_closed(out)
    np.testing.assert_array_equal(corners(*out), corners(vertices, faces))
    # Each with its own edge, not one with a hole for a waist: there is inside in the cubes and not between them.
    assert n_parts(out) == 2
    parts = trimesh.Trimesh(*out, process=False).split()
    assert [p.volume for p in parts] == pytest.approx([1, 1])


@pytest.mark.parametrize("n", [3, 4])
def test_many_wedges_around_one_edge_stay_closed(n):
    wedges = []
    for k in range(n):
        a, b = 2 * np.pi * k / n, 2 * np.pi * (k + 0.5) / n
        base = np.array([(0, 0), (np.cos(a), np.sin(a)), (np.cos(b), np.sin(b))])
        wedges.append(trimesh.creation.extrude_triangulation(base, [(0, 1, 2)], 1.0))
    rng = np.random.default_rng(n)
    vertices, faces = welded(*wedges)
    for _ in range(10):
        out = checked(vertices, faces[rng.permutation(len(faces))])
        assert is_closed(out)
        assert n_parts(out) == n


def test_two_fans_at_a_vertex_come_apart():
    vertices, faces = welded(box((0, 0, 0), (1, 1, 1)), box((1, 1, 1), (2, 2, 2)))
    assert len(vertices) == 15
    out = checked(vertices, faces)
    assert is_closed(out)
    assert len(out.vertices) == 16
    np.testing.assert_array_equal(corners(*out), corners(vertices, faces))


def test_three_sheets_that_meet_in_a_line():
    # A T: the stem is cut off, or one half of the bar; no face goes.
    line = np.column_stack([np.zeros(5), np.zeros(5), np.arange(5.0)])
    vertices = np.concatenate([line + np.array(far) for far in ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0))])
    strips = []
    for k in (1, 2, 3):
        i = np.arange(4)
        strips += [np.stack([i, i + 1, 5 * k + i], 1), np.stack([i + 1, 5 * k + i + 1, 5 * k + i], 1)]
    faces = np.concatenate(strips)
    out = checked(vertices, faces)
    np.testing.assert_array_equal(corners(*out), corners(vertices, faces))


def test_copies_of_faces_are_left_out():
    sphere = trimesh.creation.icosphere(1)
    faces = np.concatenate([sphere.faces, sphere.faces[:10, [1, 2, 0]], sphere.faces[5:7]])
    out = checked(sphere.vertices, faces)
    np.testing.assert_array_equal(corners(*out), corners(sphere.vertices, sphere.faces))
    assert is_closed(out)


def test_a_closed_surface_stays_closed_without_the_copies_of_its_faces():
    # Two tetrahedra on the same triangle, one within the other: the triangle is there twice, and is kept once.
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.2, 0.2, 1), (0.3, 0.3, 0.5)])
    tetrahedron = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    faces = np.array([*tetrahedron, *(tuple(4 if v == 3 else v for v in f) for f in tetrahedron)])
    made = checked(vertices, faces)
    assert is_closed(made)
    assert trimesh.Trimesh(*made, process=False).volume == pytest.approx(1 / 6 + 1 / 12)


def test_neighbours_are_turned_to_look_the_same_way():
    sphere = trimesh.creation.icosphere(1)
    faces = sphere.faces.copy()
    faces[::3] = faces[::3, ::-1]
    out = trimesh.Trimesh(*checked(sphere.vertices, faces), process=False)
    assert out.is_winding_consistent
    assert len(out.vertices) == len(sphere.vertices)


@pytest.mark.parametrize("name", ["moebius strip", "klein bottle", "projective plane"])
def test_one_sided_surfaces_stay_whole(name):
    faces = KINDS[name].astype(np.int64)
    vertices = np.random.default_rng(0).normal(size=(faces.max() + 1, 3))
    out = checked(vertices, faces)
    assert len(out.vertices) == len(vertices)
    np.testing.assert_array_equal(corners(*out), corners(vertices, faces))


def test_two_manifolds_are_left_as_they_are():
    for faces in KINDS.values():
        vertices = np.random.default_rng(1).normal(size=(faces.max() + 1, 3))
        out = checked(vertices, faces.astype(np.int64))
        assert (len(out.vertices), len(out.faces)) == (len(vertices), len(faces))


@pytest.mark.parametrize("seed", range(10))
def test_random_faces_on_few_vertices(seed):
    # Nearly every edge has many faces, and nearly every vertex many fans.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 12))
    vertices = rng.normal(size=(n, 3))
    faces = np.array([rng.choice(n, 3, replace=False) for _ in range(int(rng.integers(1, 60)))])
    distinct = np.unique(np.sort(faces, axis=1), axis=0)
    out = checked(vertices, faces)
    # The repair leaves out copies, and some faces that are given in both orientations.
    assert len(out.faces) <= len(distinct)
    known = {tuple(c) for c in corners(vertices, distinct)}
    assert {tuple(c) for c in corners(*out)} <= known


def test_nothing_and_repeats():
    nothing = cut(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    assert (nothing.vertices.shape, nothing.faces.shape) == ((0, 3), (0, 3))
    faces = grid(5, 4).astype(np.int64)
    vertices = np.random.default_rng(2).normal(size=(faces.max() + 1, 3))
    one, other = cut(vertices, faces), cut(vertices, faces)
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()
