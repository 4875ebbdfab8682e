"""Simplification of closed meshes: how many triangles, how far off, and that they stay closed."""

from __future__ import annotations

import analytic
import numpy as np
import pytest
import trimesh
from analytic import ring, slab, wavy

from cndhf_codec.decoder.queries import TriangleQueries
from cndhf_codec.decoder.results import TriangleMesh
from cndhf_codec.decoder.simplify import _best, _quadrics, _value, simplified


def of(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))


def as_trimesh(mesh: TriangleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize("faces", [4, 50, 500, 5000, 10**6])
def test_a_number_of_faces_is_kept_and_the_mesh_stays_closed(faces):
    ball = trimesh.creation.icosphere(5)
    out = as_trimesh(simplified(of(ball), faces=faces))
    assert len(out.faces) == min(faces, len(ball.faces))
    assert out.is_watertight
    assert out.is_winding_consistent
    assert out.euler_number == 2
    assert out.volume > 0
    if faces >= 50:
        assert out.volume == pytest.approx(ball.volume, rel=10 / faces)


@pytest.mark.parametrize("make", [wavy, ring], ids=["wavy", "ring"])
def test_a_tolerance_is_kept_and_topology_too(make):
    mesh = make().surface(96)
    counts = []
    for tolerance in (1e-3, 4e-3):
        out = simplified(mesh, tolerance)
        there = TriangleQueries(*out).nearest(mesh.vertices).distance
        assert 0.2 * tolerance < np.sqrt((there**2).mean()) < tolerance
        assert np.quantile(there, 0.99) < 2 * tolerance
        assert as_trimesh(out).is_watertight
        assert as_trimesh(out).euler_number == as_trimesh(mesh).euler_number
        counts.append(len(out.faces))
    assert counts[1] < counts[0] / 2 < len(mesh.faces) / 8


def test_flat_sides_take_few_triangles():
    mesh = analytic.model(slab((-0.51, -0.26, -0.13), (0.27, 0.53, 0.38))).surface(64)
    out = simplified(mesh, 2e-3)
    assert len(out.faces) < 60 < len(mesh.faces) / 100
    assert as_trimesh(out).volume == pytest.approx(0.78 * 0.79 * 0.51, rel=0.01)


def test_a_torus_stops_at_what_its_topology_needs():
    out = as_trimesh(simplified(of(trimesh.creation.torus(1.0, 0.4, 24, 12)), faces=4))
    assert 14 <= len(out.faces) < 40  # no torus has fewer than 14
    assert out.is_watertight
    assert out.euler_number == 0


def test_no_face_turns_over():
    mesh = wavy().surface(64)
    out = as_trimesh(simplified(mesh, faces=1000))
    queries = TriangleQueries(*mesh)
    face = queries.nearest(out.triangles_center).face
    cosine = (as_trimesh(mesh).face_normals[face] * out.face_normals).sum(axis=1)
    assert (cosine > 0).mean() > 0.99


def test_edges_of_four_faces_stay():
    two = trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))])
    two.vertices[8:] += [1, 1, 0]
    two.merge_vertices()
    fine = two.subdivide().subdivide()
    out = as_trimesh(simplified(of(fine), 1e-4))
    assert len(out.faces) < len(fine.faces) / 2
    assert out.volume == pytest.approx(2)
    shared = np.unique(np.sort(out.edges, axis=1), axis=0, return_counts=True)[1]
    assert set(shared) == {2, 4}
    assert (shared == 4).sum() == 4


def test_equal_meshes_give_equal_ones():
    mesh = wavy().surface(48)
    first, second = simplified(mesh, 1e-3), simplified(mesh, 1e-3)
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)


def test_a_collapse_is_nowhere_worse_than_at_its_ends_and_middle():
    rng = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(3)
    bumpy = mesh.vertices * (1 + rng.normal(0, 0.001, (len(mesh.vertices), 1)))
    quadrics = _quadrics(bumpy, np.asarray(mesh.faces, dtype=np.int64))[0]
    first, second = mesh.edges_unique.T
    a, b, both = bumpy[first], bumpy[second], quadrics[:, first] + quadrics[:, second]
    least = np.min([_value(both, p.T) for p in (a, b, (a + b) / 2)], axis=0)
    place, value = _best(both, a, b)
    far = np.linalg.norm(place - (a + b) / 2, axis=1) > 2.001 * np.linalg.norm(a - b, axis=1)
    assert not far.any()
    assert (value <= least + 1e-12).all()
