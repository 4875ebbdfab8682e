"""Axis selection: candidates, visibility on simple shapes, rarity, greedy choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from cndhf_codec.encoder.paper.axes import candidates, choose_axes, effective_area, visibility
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.mesh.sampling import fibonacci_sphere
from cndhf_codec.mesh.solid import Solid


def solid_of(shape) -> Solid:
    if isinstance(shape, Manifold):
        m = shape.to_mesh()
        shape = trimesh.Trimesh(m.vert_properties[:, :3], m.tri_verts, process=False)
    return Solid(np.array(shape.vertices, dtype=np.float64), np.array(shape.faces, dtype=np.int64))


def cube(x, y, z, at=(0, 0, 0)) -> Manifold:
    return Manifold.cube([x, y, z], True).translate(at)


def test_fibonacci_lattice():
    p = fibonacci_sphere(50)
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 1)
    # By hand: z = 0.98 and r = sqrt(1 - z^2), at longitudes 0 and 222.4922 degrees (1 / golden ratio of a turn).
    np.testing.assert_allclose(p[0], [0.198997, 0, 0.98], atol=1e-6)
    np.testing.assert_allclose(p[1][2], 0.94)
    assert np.degrees(np.arctan2(p[1, 1], p[1, 0])) % 360 == pytest.approx(222.492236, abs=1e-5)
    # Evenly spread: no two closer than half the mean spacing sqrt(4 pi / 50).
    gap = np.arccos(np.clip(p @ p.T - 2 * np.eye(50), -1, 1)).min()
    assert gap > 0.25
    np.testing.assert_allclose(p.mean(axis=0), 0, atol=0.02)


def test_candidates_end_with_the_coordinate_axes():
    assert candidates().shape == (53, 3)
    assert candidates()[-3:].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_candidates_turn_by_the_golden_angle():
    # By hand: 137.507764 degrees, the smaller part of a turn in the golden ratio.
    x, y, _ = candidates()[1]
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(137.507764, abs=1e-5)


CONVEX = [trimesh.creation.icosphere(3, 0.9), trimesh.creation.box((1, 0.5, 0.8))]


def parallel(solid: Solid, directions) -> np.ndarray:
    """Faces whose planes hold the direction: whether they are seen depends on float rounding."""
    return np.abs(directions @ solid.normals.T) < 1e-2


@pytest.mark.parametrize("shape", CONVEX)
def test_a_convex_shape_is_seen_whole_from_everywhere(shape):
    solid = solid_of(shape)
    assert (visibility(solid, candidates(), 0, 1) | parallel(solid, candidates())).all()


@pytest.mark.parametrize("shape", CONVEX)
def test_faces_along_the_axis_of_a_convex_shape_are_seen(shape):
    assert visibility(solid_of(shape), np.eye(3), 0, 1).all()


def c_shape() -> Manifold:
    """A cube with a slot through it along y, open to +x: the slot's walls look along +-z."""
    return cube(1, 1, 1) - cube(1, 2, 0.2, (0.3, 0, 0))


def test_walls_of_a_slot_are_seen_along_the_slot_and_not_across_it():
    solid = solid_of(c_shape())
    # Into the slot, a little upward: that sees its floor and not its ceiling.
    up, down, z = visibility(solid, np.array([[1, 0, 0.02], [1, 0, -0.02], [0, 0, 1]]), 0, 1)
    centre = solid.vertices[solid.faces].mean(axis=1)
    floor, ceiling = ((np.abs(centre[:, 2] - at) < 1e-3) & (np.abs(solid.normals[:, 2]) > 0.9) for at in (-0.1, 0.1))
    assert floor.sum() >= 2
    assert ceiling.sum() >= 2
    assert up[floor].all()
    assert not up[ceiling].any()
    assert down[ceiling].all()
    assert not down[floor].any()
    assert not z[floor | ceiling].any()
    assert z[np.abs(centre[:, 2]) > 0.49].all()


def test_a_cavity_is_seen_from_nowhere():
    solid = solid_of(cube(1, 1, 1) - cube(0.4, 0.4, 0.4))
    inner = np.abs(solid.vertices[solid.faces]).max(axis=(1, 2)) < 0.3
    assert inner.sum() == 12
    seen = visibility(solid, candidates(), 0, 1)
    assert not seen[:, inner].any()
    assert (seen | parallel(solid, candidates()))[:, ~inner].all()
    choice = choose_axes(solid, replace(PAPER, max_axes=3), 0, 1)
    assert choice.visible == pytest.approx(1 / (1 + 0.4**2))


def test_visibility_does_not_depend_on_threads():
    solid = solid_of(c_shape())
    directions = candidates()[:8]
    assert np.array_equal(visibility(solid, directions, 3, 1), visibility(solid, directions, 3, 2))


AREAS = np.array([1.0, 2.0, 4.0, 8.0])
# Seen by 3, 1, 2 and no candidates; the mean over the seen ones is 2.
SEEN = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 0, 0, 0]], dtype=bool)


def test_effective_area_as_printed():
    np.testing.assert_allclose(effective_area(AREAS, SEEN, "printed"), [1.5, 2, 4, 0])


def test_effective_area_inverse():
    np.testing.assert_allclose(effective_area(AREAS, SEEN, "inverse"), [1, 4, 4, 0])


@pytest.mark.parametrize("rarity", ["printed", "inverse"])
def test_effective_area_where_nothing_is_seen(rarity):
    assert effective_area(AREAS, np.zeros_like(SEEN), rarity).tolist() == [0, 0, 0, 0]


def test_one_axis_is_enough_for_a_convex_shape():
    choice = choose_axes(solid_of(trimesh.creation.icosphere(3)), replace(PAPER, max_axes=3), 0, 1)
    assert choice.axes.shape == (1, 3)
    assert choice.covered.tolist() == [1]
    assert choice.visible == 1


@pytest.mark.parametrize("rarity", ["printed", "inverse"])
def test_greedy_choice(rarity):
    # A box with a blind slot in each of three sides: no single axis sees the walls of all.
    shape = cube(1, 1, 1)
    for slot in (
        cube(0.2, 0.6, 0.6, (0, 0, 0.4)),
        cube(0.6, 0.6, 0.2, (0.4, 0, 0)),
        cube(0.6, 0.2, 0.6, (0, 0.4, 0)),
    ):
        shape -= slot
    solid = solid_of(shape)
    choice = choose_axes(solid, replace(PAPER, rarity=rarity), 0, 1)
    assert len(choice.axes) >= 2
    assert (np.diff(choice.covered) > 0).all()
    assert choice.covered[-1] <= choice.visible <= 1
    np.testing.assert_allclose(np.linalg.norm(choice.axes, axis=1), 1)
    two = choose_axes(solid, replace(PAPER, rarity=rarity, max_axes=2), 0, 1)
    assert np.array_equal(two.axes, choice.axes[:2])
