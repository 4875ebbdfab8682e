"""Parts are counted as a person would, and volumes are exact where they can be."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from dirty import CUBE, box, sheet, solid_of, touching

from cndhf_codec import check
from cndhf_codec.mesh.bodies import Bodies, bodies_of_solid, bodies_of_surface, filled_volume


def ball(radius: float, at=(0, 0, 0), inverted=False) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(3, radius)
    mesh.apply_translation(at)
    if inverted:
        mesh.invert()
    return mesh


def of_solid(*meshes: trimesh.Trimesh) -> Bodies:
    return bodies_of_solid(solid_of(*meshes), 0)


def of_surface(*meshes: trimesh.Trimesh) -> Bodies:
    mesh = trimesh.util.concatenate(list(meshes))
    return bodies_of_surface(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))


@pytest.mark.parametrize("count", [of_solid, of_surface])
def test_parts_apart(count):
    found = count(*[ball(0.05, (0.3 * k, 0, 0)) for k in range(-2, 3)])
    assert (found.parts, found.minor) == (5, 0)
    assert found.volume == pytest.approx(5 * ball(0.05).volume)
    assert count(ball(0.5)).parts == 1


@pytest.mark.parametrize("count", [of_solid, of_surface])
def test_cavities_are_no_parts(count):
    found = count(ball(0.8), ball(0.4, inverted=True))
    assert (found.parts, found.minor) == (1, 0)
    assert found.volume == pytest.approx(ball(0.8).volume - ball(0.4).volume)


def test_specks_are_counted_apart():
    for count in (of_solid, of_surface):
        found = count(ball(0.5), ball(0.002, (0.7, 0, 0)), ball(0.002, (-0.7, 0, 0)))
        assert (found.parts, found.minor) == (1, 2)


def test_parts_that_overlap_touch_or_hold_each_other_are_one():
    a = box([-0.5] * 3, [0.1] * 3)
    assert of_solid(a, box([0] * 3, [0.5] * 3)).parts == 1  # overlap
    assert of_solid(a, box([0.1, -0.3, -0.3], [0.4, 0, 0])).parts == 1  # share a part of a side
    assert of_solid(a, box([-0.3] * 3, [-0.1] * 3)).parts == 1  # one within the other
    assert of_solid(a, box([-0.3, -0.3, -0.9], [-0.2, -0.2, 0.9])).parts == 1  # no vertex within the other
    assert of_solid(a, box([0.15, -0.3, -0.3], [0.4, 0, 0])).parts == 2
    assert of_solid(touching()).parts == 1


def test_the_volume_of_overlapping_parts_is_that_of_their_union():
    found = of_solid(box([-0.5] * 3, [0.1] * 3), box([0] * 3, [0.5] * 3))
    assert found.volume == pytest.approx(0.6**3 + 0.5**3 - 0.1**3, rel=2e-3)
    within = of_solid(box([-0.5] * 3, [0.1] * 3), box([-0.3] * 3, [-0.1] * 3))
    assert within.volume == pytest.approx(0.6**3, rel=2e-3)


def test_the_volume_of_closed_surfaces_is_exact():
    assert of_solid(box(*CUBE)).volume == pytest.approx(1, rel=1e-12)
    assert of_solid(box(*CUBE, inverted=True)).volume == pytest.approx(1, rel=1e-12)
    needle = box([-1, -1e-3, -1e-3], [1, 1e-3, 1e-3])
    assert of_solid(needle).volume == pytest.approx(8e-6, rel=1e-12)
    flat = box([-0.7, -0.7, -1e-4], [0.7, 0.7, 1e-4])
    assert of_solid(flat).volume == pytest.approx(0.7**2 * 8e-4, rel=1e-12)


def test_the_volume_of_an_open_surface():
    mesh = box(*CUBE).subdivide().subdivide().subdivide()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    solid = solid_of(mesh)
    assert not solid.closed
    assert bodies_of_solid(solid, 0).volume == pytest.approx(1, rel=1e-2)


def test_what_height_fields_fill():
    hollow = solid_of(ball(0.8), ball(0.4, inverted=True))
    assert filled_volume(hollow, np.eye(3)) == pytest.approx(ball(0.4).volume, rel=0.03)
    assert filled_volume(solid_of(box(*CUBE)), np.eye(3)) < 1e-3
    # A bowl is filled when it is seen from the side only.
    outer, inner = trimesh.creation.cylinder(0.6, 0.8), trimesh.creation.cylinder(0.4, 0.8)
    bowl = trimesh.boolean.difference([outer, inner.apply_translation([0, 0, 0.2])], engine="manifold")
    assert filled_volume(solid_of(bowl), np.eye(3)[:1]) == pytest.approx(np.pi * 0.4**2 * 0.6, rel=0.05)
    assert filled_volume(solid_of(bowl), np.eye(3)[2:]) < 0.01


def test_a_sheet_beside_a_solid_is_not_a_part():
    flag = sheet().apply_scale(0.3).apply_translation([0, 0, 0.9])
    assert of_solid(box(*CUBE), flag).parts == 1


def test_small_parts_far_apart_are_parts():
    found = of_solid(ball(0.002, (-0.9, 0, 0)), ball(0.002, (0.9, 0, 0)))
    assert (found.parts, found.minor) == (2, 0)


def test_what_lies_within_the_solid_is_not_missed():
    inner = box([-0.2] * 3, [0.2] * 3)
    assert check(trimesh.util.concatenate([box(*CUBE), inner])).hidden == 0
    inner.invert()
    found = check(trimesh.util.concatenate([box(*CUBE), inner]))
    assert found.hidden == pytest.approx(0.16 / 1.16, abs=0.01)
    assert found.filled == pytest.approx(0.4**3, rel=0.1)


@pytest.mark.parametrize("size", [(4, 3, 1), (10, 20, 30), (2, 1, 0.1)])
def test_boxes_are_checked_in_finite_time(size):
    # A cosine of 1 + 2e-16 made their best axes cost less than nothing, and the search for better ones endless.
    assert check(trimesh.creation.box(size)).volume == pytest.approx(np.prod(size))


def test_shells_that_share_vertices_are_no_more_than_the_largest():
    # Three levels of detail of one octahedron, the finer ones on its corners.
    levels = [trimesh.creation.icosphere(k) for k in (0, 1, 2)]
    assert of_solid(*levels).volume == pytest.approx(levels[2].volume, rel=0.01)


def test_an_open_surface_has_a_noise_and_no_certain_parts():
    cracked = ball(0.5)
    cracked.update_faces(np.arange(len(cracked.faces)) > 0)
    found = of_solid(cracked)
    assert not found.closed
    assert 0 < found.noise < 0.05
    assert of_solid(ball(0.5)).closed
    assert of_solid(ball(0.5)).noise == 0


def test_a_hollow_ball_inside_out_stays_hollow():
    found = of_solid(ball(0.8, inverted=True), ball(0.4))
    assert found.volume == pytest.approx(ball(0.8).volume - ball(0.4).volume)
    # Where the shell looks outward, what is within it stays as it is given.
    assert of_solid(ball(0.8), ball(0.4)).volume == pytest.approx(ball(0.8).volume, rel=0.01)
