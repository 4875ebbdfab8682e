"""The frame of the grid: planes of mechanical parts lie along its axes."""

from __future__ import annotations

import manifolds
import numpy as np
import pytest
import trimesh
from control_meshes import arrays
from quietly import encode_quietly
from scipy.spatial.transform import Rotation

from cndhf_codec.encoder.surface.frame import turned_frame
from cndhf_codec.format.constants import QUATERNION_ONE
from cndhf_codec.format.container import rotation_matrix
from cndhf_codec.format.surface.section import check_quaternion

TURN = Rotation.from_rotvec([0.5, 0.9, -0.4]).as_matrix()


def part() -> trimesh.Trimesh:
    """A block with a bevel and a round boss, whose planes along the axes have most of its area."""
    block = trimesh.creation.box((0.9, 0.6, 0.3))
    block.vertices[(block.vertices > 0).all(axis=1)] -= 0.05
    boss = trimesh.creation.cylinder(0.2, 0.4, sections=32)
    return trimesh.util.concatenate([block, boss])


def test_the_planes_of_a_turned_part_are_found():
    mesh = arrays(part())
    quaternion = turned_frame(mesh.vertices @ TURN.T, mesh.faces)
    assert quaternion is not None
    axes = rotation_matrix(quaternion) @ TURN  # of the grid, as the part was before
    nearest = np.abs(axes).argmax(axis=1)
    assert sorted(nearest) == [0, 1, 2]
    # Nearer than rounding to a quaternion of length 32767 would be.
    assert np.abs(np.abs(axes) - np.eye(3)[nearest]).max() < 1e-5
    assert np.linalg.det(axes) == pytest.approx(1)


def test_a_part_along_the_axes_and_a_round_shape_stay_as_they_are():
    for mesh in (arrays(part()), arrays(trimesh.creation.icosphere(4)), arrays(trimesh.creation.torus(0.5, 0.2))):
        assert turned_frame(mesh.vertices, mesh.faces) is None


@pytest.mark.parametrize("degrees", [0.3, 2.0, 5.0, 10.0, 90.0, 178.0])
def test_any_turn_is_found_and_can_be_stored(degrees):
    box = arrays(trimesh.creation.box((0.3, 0.6, 0.9)).subdivide())
    rng = np.random.default_rng(int(10 * degrees))
    for axis in rng.normal(size=(20, 3)):
        turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
        quaternion = turned_frame(box.vertices @ turn.T, box.faces)
        assert quaternion is not None
        check_quaternion(quaternion, "frame")
        assert max(map(abs, quaternion)) <= QUATERNION_ONE
        places = box.vertices @ turn.T @ rotation_matrix(quaternion).T
        assert sorted(np.ptp(places, axis=0)) == pytest.approx([0.3, 0.6, 0.9], abs=5e-5)


def test_planes_are_not_enough_where_coordinates_repeat_as_it_is():
    # Pyramids on a lattice: their sides are planes at 45 degrees.
    x, y = np.meshgrid(np.arange(7) / 8 - 0.4, np.arange(7) / 8 - 0.4, indexing="ij")
    height = (np.arange(7)[:, None] % 2) * (np.arange(7) % 2) / 8
    lattice = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    assert turned_frame(lattice, manifolds.grid(6, 6)) is None


def test_single_triangles_are_no_planes():
    for seed in range(10):
        hull = trimesh.convex.convex_hull(np.random.default_rng(seed).normal(size=(16, 3)))
        assert turned_frame(*arrays(hull)[:2]) is None


def test_one_direction_of_planes_is_enough():
    # The sides of a prism are along few directions, and none of them across another.
    prism = arrays(trimesh.creation.cylinder(0.8, 0.1, sections=7))
    quaternion = turned_frame(prism.vertices @ TURN.T, prism.faces)
    assert quaternion is not None
    assert np.abs(rotation_matrix(quaternion) @ TURN @ [0, 0, 1]).max() > 1 - 1e-9


def test_a_turned_sheet_lies_along_the_grid():
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 7), np.linspace(-0.5, 0.5, 6), indexing="ij")
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(42)])
    quaternion = turned_frame(sheet @ TURN.T, manifolds.grid(6, 5))
    assert quaternion is not None
    assert np.ptp(sheet @ TURN.T @ rotation_matrix(quaternion).T, axis=0).min() < 1e-5


def test_a_turned_part_has_hardly_more_error():
    mesh = part()
    errors = []
    for turn in (np.eye(3), TURN):
        turned = mesh.copy()
        turned.vertices = mesh.vertices @ turn.T
        model, report = encode_quietly(turned, preset="fast", representation="surface", target_size=500)
        assert (model.container.surface.quaternion == (0, 0, 0, 32767)) == (turn is not TURN)
        assert len(model.dumps()) <= 500
        errors.append(report.normalised.mean)
    assert errors[1] < 1.5 * errors[0] + 1e-5
