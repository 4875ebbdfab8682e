"""Mirror planes are found where they are, and used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from quietly import encode_quietly
from scipy.spatial.transform import Rotation

from cndhf_codec.encoder import settings
from cndhf_codec.encoder.dhf.axes.costs import AxisCosts
from cndhf_codec.encoder.dhf.axes.mirrors import frame_with_mirrors, mirror_planes
from cndhf_codec.encoder.dhf.fit.clear_space import ClearSpace
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.dhf.fit.samples import draw_samples
from cndhf_codec.encoder.dhf.fit.targets import height_targets
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode

TURN = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
SHIFT = np.array([0.05, -0.02, 0.03])


def creature(side: float = 0.0) -> trimesh.Trimesh:
    """A body with a head in front and two arms; `side` makes one arm longer."""
    parts = [
        trimesh.creation.box((0.5, 0.9, 0.4)),
        trimesh.creation.box((0.3, 0.3, 0.3), trimesh.transformations.translation_matrix((0, 0.5, 0.3))),
        trimesh.creation.box((1.2 + side, 0.2, 0.2), trimesh.transformations.translation_matrix((side / 2, 0.1, 0.05))),
    ]
    return trimesh.boolean.union(parts, engine="manifold")


def solid(mesh: trimesh.Trimesh, turn: np.ndarray = TURN) -> Solid:
    return Solid(np.asarray(mesh.vertices) @ turn.T + SHIFT, np.asarray(mesh.faces, dtype=np.int64))


def test_a_mirror_plane_is_found_in_any_pose():
    (plane,) = mirror_planes(solid(creature()), 0)
    assert abs(plane.normal @ TURN[:, 0]) == pytest.approx(1, abs=1e-9)
    assert plane.offset == pytest.approx(plane.normal @ SHIFT, abs=1e-9)
    assert plane.error < 1e-9


def test_a_shape_that_is_not_its_mirror_image_has_none():
    assert mirror_planes(solid(creature(side=0.1)), 0) == []


def test_planes_stand_at_right_angles():
    planes = mirror_planes(solid(trimesh.creation.box((1, 0.7, 0.4))), 0)
    normals = np.stack([p.normal for p in planes])
    np.testing.assert_allclose(np.abs(normals @ TURN).sum(axis=0), 1, atol=1e-6)
    # A square prism has more planes than two across its side; a ball has any.
    for shape in (trimesh.creation.box((1, 1, 0.4)), trimesh.creation.icosphere(4)):
        normals = np.stack([p.normal for p in mirror_planes(solid(shape, np.eye(3)), 0)])
        np.testing.assert_allclose(normals @ normals.T, np.eye(len(normals)), atol=0.01)
        assert len(normals) == 3


def test_the_middle_of_the_box_is_the_plane():
    s = solid(creature())
    planes = mirror_planes(s, 0)
    within = TURN @ [0, 0.6, 0.8]
    frame = frame_with_mirrors(within, s.vertices, planes)
    assert frame.fold == 1
    np.testing.assert_allclose(frame.rotation[2], within, atol=1e-4)
    assert frame.mirrors[0] == pytest.approx(frame.rotation[0] @ SHIFT, abs=1e-4)
    uvz = s.vertices @ frame.rotation.T
    lo, hi = frame.bounds.T
    assert (uvz >= lo).all()
    assert (uvz <= hi).all()
    # What the file can say is what the encoder thinks: both halves of the heights on one.
    t = height_targets(s, frame, 64)
    assert t.uv[..., 0].min() >= frame.mirrors[0] - 1e-6
    both = t.hit & t.hit[::-1]
    assert (t.hit == t.hit[::-1]).mean() > 0.98
    assert np.median(np.abs(t.far - t.far[::-1])[both]) < 1e-3
    # Not within the plane: no mirror.
    assert frame_with_mirrors(TURN @ [0.6, 0, 0.8], s.vertices, planes).fold == 0


def test_two_planes_fold_twice():
    s = solid(trimesh.creation.box((1, 0.7, 0.4)))
    frame = frame_with_mirrors(TURN[:, 2], s.vertices, mirror_planes(s, 0))
    assert frame.fold == 3
    np.testing.assert_allclose(frame.mirrors, frame.rotation[:2] @ SHIFT, atol=1e-4)


def test_samples_of_both_sides_are_one():
    s = solid(creature())
    planes = mirror_planes(s, 0)
    frames = [frame_with_mirrors(TURN @ a, s.vertices, planes) for a in ([0, 0, 1.0], [1.0, 0, 0])]
    samples = draw_samples(s, frames, 4000, 0)
    image = replace(
        samples, surface=(samples.surface - 2 * ((samples.surface - SHIFT) @ TURN[:, :1]) * TURN[:, 0]).astype("f4")
    )
    clear = ClearSpace(s, frames, samples.sides, 8)
    here, there = (JointLoss(x, clear, frames, ThreadPool(1)) for x in (samples, image))
    torch.testing.assert_close(here.store.surface[0], there.store.surface[0], atol=2e-4, rtol=0)
    assert (here.store.surface[1] - there.store.surface[1]).abs().max() > 0.1


def test_axes_within_the_plane_are_tried():
    s = solid(creature())
    costs = AxisCosts(s, 0, ThreadPool(1), mirror_planes(s, 0))
    mirrored = costs.axes[costs.sets(2)[-1]]
    along = np.abs(mirrored @ TURN[:, 0])
    assert ((along < 1e-9) | (along > 1 - 1e-9)).all()


def test_a_symmetric_shape_is_stored_with_one_side(monkeypatch, tmp_path):
    tiny = replace(
        settings.PRESETS["default"], steps=60, batch=512, samples=20_000, trial_steps=60, joint_steps=200, rounds=2
    )
    tiny = replace(tiny, round_steps=30, target_resolution=96, verify_resolution=64, max_axes=2)
    monkeypatch.setitem(settings.PRESETS, "fast", tiny)
    turned = creature().apply_transform(trimesh.transformations.rotation_matrix(0.5, [1, 2, 3]))
    model, report = encode_quietly(turned, preset="fast", representation="dhf", target_size=1500)
    assert any(d.fold for d in model.container.dhfs)
    assert report.normalised.mean < 0.03
    assert len(model.dumps()) <= 1500
