"""The counterexample search finds what is wrong between samples."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import torch
from jointly import networks, quiet

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.fit.active_set import TOLERANCE
from cndhf_codec.encoder.dhf.fit.counterexamples import ADDED_BELOW, DOUBTFUL
from cndhf_codec.encoder.dhf.fit.joint import Schedule, joint_fit
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.thread_pool import ThreadPool

pytestmark = pytest.mark.encode


def test_floaters_are_found(joint_loss):
    # Networks whose heights are constant, the far above the near: everything in the boxes is inside.
    nets = networks(width=6)
    nets.theta.zero_()
    nets.theta[:, -2:] = torch.tensor([-2.0, 2.0])
    assert joint_loss.artifacts(nets) > 10_000
    joint_fit(nets, joint_loss, Schedule(512, 1, 1e-9), 0, quiet, Deadline())
    assert joint_loss.store.kept[0] > 1000
    _, off = joint_loss.active.draw(10, 400, np.random.default_rng(0))
    assert (off >= joint_loss.store.n_space).sum() == 100
    _, off = joint_loss.active.rows(joint_loss.active.draw_steps(10, 400, 3, np.random.default_rng(0)).part(2, 3))
    assert (off >= joint_loss.store.n_space).sum() == 100
    inverted = nets.copy()
    inverted.theta[:, -2:] = torch.tensor([2.0, -2.0])
    assert len(joint_loss.search.floaters(inverted, 0.0)) == 0
    assert joint_loss.artifacts(inverted) > 1000  # the whole solid is cut away


@pytest.mark.parametrize("cut", [True, False])
def test_what_is_wrong_near_the_surface_is_found(samples, clear, frames, solid, cut):
    joint_loss = JointLoss(samples, clear, frames, ThreadPool(1))
    nets = networks(width=6)
    nets.theta.zero_()
    # Everything is cut away, or nothing.
    nets.theta[:, -2:] = torch.tensor([0.5, -0.5] if cut else [-2.0, 2.0])
    wrong, right = (joint_loss.search.doubtful(nets, side) for side in ((1, 0) if cut else (0, 1)))
    assert len(wrong[0]) > 1000
    assert (wrong[1] < 0).all()
    assert len(right[0]) == 0
    joint_loss.active.refresh(nets, TOLERANCE)
    assert joint_loss.store.kept[int(not cut)] == 0
    rows = joint_loss.store.counterexamples(int(cut))
    assert len(rows) > 1000
    assert (joint_loss.store.inside[rows] == cut).all()
    points = (joint_loss.store.space[0][rows] @ joint_loss.store._rotations[0].T).numpy().astype(float)
    assert np.sqrt(igl.point_mesh_squared_distance(points, solid.vertices, solid.faces)[0]).min() > 0.02
    assert (solid.contains(points) == cut).mean() > 0.99
    # The next search looks around what was found, too.
    assert [len(known) for known in joint_loss.search.remembered] == ([0, 2000] if cut else [2000, 0])
    assert len(joint_loss.search.doubtful(nets, int(cut))[0]) > 1000


def test_of_doubtful_points_only_the_wrong_ones_become_samples(samples, clear, frames):
    joint_loss = JointLoss(samples, clear, frames, ThreadPool(1))
    nets = networks(width=6)
    nets.theta.zero_()
    # Slabs: outside them -f grows with the distance from a plane, through all values.
    nets.theta[:, -2:] = torch.tensor([-0.3, 0.3])
    added = {side: points for side, points, _, _ in list(joint_loss.search.find(nets))[1:]}

    def value(points: np.ndarray) -> np.ndarray:
        return np.min([0.3 - np.abs(points @ f.rotation[2]) for f in frames], axis=0)

    remembered = joint_loss.search.remembered[0]
    assert (-value(remembered) < DOUBTFUL + 1e-5).all()
    assert (-value(remembered) > ADDED_BELOW[0]).sum() > 20  # around these the next search looks
    assert len(added[0]) > 100
    assert (-value(added[0]) < ADDED_BELOW[0] + 1e-5).all()
    assert (value(added[1]) < ADDED_BELOW[1] + 1e-5).all()
