"""The active set: what batches are drawn from."""

from __future__ import annotations

import numpy as np
import pytest
from jointly import networks

from cndhf_codec.encoder.dhf.fit.active_set import TOLERANCE, ActiveSet, _runs
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.thread_pool import ThreadPool

pytestmark = pytest.mark.encode


def test_what_is_left_out_costs_nothing(samples, clear, frames, monkeypatch):
    monkeypatch.setattr(ActiveSet, "_quotas", lambda self, n: [])  # violations are drawn more often on purpose
    nets = networks(count=2)
    losses = []
    for tolerance in (1e3, TOLERANCE):
        joint_loss = JointLoss(samples, clear, frames, ThreadPool(1))
        joint_loss.active.refresh(nets, tolerance)
        rng = np.random.default_rng(0)
        batches = joint_loss.active.draw_steps(2000, 2000, 60, rng)
        losses.append(
            np.mean([joint_loss.gradient(nets, batch)[1] for batch in map(batches.part, range(60), range(1, 61))])
        )
    assert joint_loss.active._active < 0.9 * joint_loss.store.n_space
    assert losses[1] == pytest.approx(losses[0], rel=0.03)


def test_runs_are_uniform():
    rng = np.random.default_rng(0)
    for first, last in ((5, 6), (0, 40), (100, 500)):
        at = _runs(first, last, 1000, 200, rng)
        assert at.shape == (200, 1000)
        counts = np.bincount(at.ravel(), minlength=last)
        assert counts[:first].sum() == 0
        assert counts[first:].min() > 0.5 * counts[first:].max()
    assert _runs(7, 7, 10, 3, rng).shape == (3, 0)
