"""Solids of dirty surfaces: copies, double walls, walls within, shuffled and inverted faces, parts within parts."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from dirty import CUBE, box, is_closed_and_outward, sheet, solid_of, touching

from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-0.9, 0.9, (3000, 3))


def within(points, lo, hi):
    return ((points > lo) & (points < hi)).all(axis=1)


def test_a_clean_mesh_is_left_as_it_is():
    mesh = read_mesh(trimesh.creation.icosphere(3))
    solid = Solid(mesh.vertices, mesh.faces)
    assert np.array_equal(solid.faces, solid.given)
    assert sorted(map(tuple, solid.faces)) == sorted(map(tuple, mesh.faces))
    assert (solid.flipped, solid.behind, solid.open, solid.sheet.any()) == (0, 0, 0, False)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_shuffled_orientation(points, share):
    sphere = trimesh.creation.icosphere(3, 0.8)
    turned = np.random.default_rng(0).random(len(sphere.faces)) < share
    faces = np.where(turned[:, None], sphere.faces[:, ::-1], sphere.faces)
    solid = solid_of(trimesh.Trimesh(sphere.vertices, faces, process=False))
    assert is_closed_and_outward(solid, sphere.volume)
    assert solid.flipped == pytest.approx(turned.mean(), abs=0.05)


def test_every_face_twice():
    inside_out = box(*CUBE, inverted=True)
    for copies in ([box(*CUBE), box(*CUBE)], [box(*CUBE), inside_out], [inside_out] * 3):
        solid = solid_of(*copies)
        assert is_closed_and_outward(solid, 1)
        assert len(solid.given) == 12 * len(copies)


def test_the_wall_between_two_parts_that_touch():
    solid = solid_of(touching())
    assert solid.repaired.dropped_pairs == 2
    assert is_closed_and_outward(solid, 1)


def test_a_small_flap_is_dropped_and_a_large_one_kept():
    ball = trimesh.creation.icosphere(3, 0.8)
    a, b = ball.vertices[ball.edges_unique[0]]
    for length, dropped in ((1.02, 1), (3.0, 0)):
        tip = (a + b) / 2 * length
        flap = trimesh.Trimesh([a, b, tip], [[0, 1, 2], [0, 2, 1]], process=False)
        solid = solid_of(ball, flap)
        assert solid.repaired.dropped_pairs == dropped
        assert solid.repaired.doubled.sum() == 1 - dropped


def test_an_inverted_part_within_does_not_turn_the_inside_round(points):
    shell, inner = box(*CUBE), ([-0.2] * 3, [0.2] * 3)
    for part in (box(*inner), box(*inner, inverted=True)):
        solid = solid_of(shell, part)
        assert solid.first_hits(np.array([[0.1, 0.1, 2]]), [0, 0, -1])[0] >= 0
        expected = within(points, *CUBE)
        if part.volume < 0:  # a cavity
            expected &= ~within(points, *inner)
        assert np.array_equal(solid.contains(points), expected)


def test_overlapping_parts_are_one(points):
    a, b = ([-0.6] * 3, [0.2] * 3), ([-0.2] * 3, [0.6] * 3)
    for parts in ([box(*a), box(*b)], [box(*a, inverted=True), box(*b)]):
        expected = within(points, *a) | within(points, *b)
        assert np.array_equal(solid_of(*parts).contains(points), expected)


def test_what_is_open():
    sphere = trimesh.creation.icosphere(4, 0.9)
    capless = trimesh.Trimesh(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] < 0.72], process=False)
    lidless = box(*CUBE).subdivide_loop(0)
    lidless.update_faces(lidless.triangles_center[:, 2] < 0.49)
    for mesh, behind, is_open in ((sphere, 0, 0), (capless, 0.09, 0), (lidless, 1 / 6, 1), (sheet(), 0.5, 1)):
        solid = solid_of(mesh)
        assert solid.behind == pytest.approx(behind, abs=0.03)
        assert solid.open == is_open


def test_a_strip_with_half_a_turn_has_no_inside():
    n = 200
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    out = np.hstack([np.cos(t), np.sin(t), 0 * t])
    wide = 0.2 * (np.cos(t / 2) * out + np.sin(t / 2) * np.array([0, 0, 1]))
    vertices = np.concatenate([0.7 * out + wide, 0.7 * out - wide])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    last = j == 0  # there the sides change places
    a, b, c, d = i, i + n, np.where(last, j + n, j), np.where(last, j, j + n)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    solid = solid_of(trimesh.Trimesh(vertices, faces, process=False))
    assert len(solid.repaired.open_patch) == 1
    assert solid.open == 1
