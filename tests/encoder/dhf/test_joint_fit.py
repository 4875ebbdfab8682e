"""The joint fit: rates, deadlines, idle fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from jointly import SMALL, Looks, job_of, networks, of_widths, plan_of, quiet

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.axes import trials
from cndhf_codec.encoder.dhf.fit import fields
from cndhf_codec.encoder.dhf.fit.active_set import TOLERANCE, ActiveSet
from cndhf_codec.encoder.dhf.fit.joint import CALL_STEPS, LEAST_RATE_SHARE, IdleNetworkError, Schedule, joint_fit
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.dhf.job import Plan
from cndhf_codec.encoder.dhf.network.soap import Soap
from cndhf_codec.encoder.dhf.records import finest_codes, records_of
from cndhf_codec.encoder.dhf.widths import widths_for
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.errors import EncodeError

pytestmark = pytest.mark.encode


def test_a_joint_fit_that_diverges_is_an_error(joint_loss):
    nets = networks()
    nets.theta[1, 50] = float("nan")
    with pytest.raises(EncodeError, match=r"diverged.*seed"):
        joint_fit(nets, joint_loss, Schedule(64, 2, 1e-3), 0, quiet, Deadline())


def test_the_joint_fit_lowers_the_loss_and_keeps_what_is_held(samples, clear, frames):
    nets = networks()
    losses: list[float] = []
    held = torch.zeros(nets.theta.shape, dtype=torch.bool)
    held[0, 100:300] = True
    trained_on = JointLoss(samples, clear, frames, ThreadPool(1))
    joint_fit(nets, trained_on, Schedule(512, 300, 3e-3), 0, lambda step, loss: losses.append(loss), Deadline(), held)
    assert losses[-1] < losses[0]
    start = networks()
    fresh = JointLoss(samples, clear, frames, ThreadPool(1))
    batch = fresh.active.draw_steps(5000, 5000, 1, np.random.default_rng(1))
    assert fresh.gradient(nets, batch)[1] < 0.3 * fresh.gradient(start, batch)[1]
    assert torch.equal(nets.theta[held], start.theta[held])
    assert (nets.theta[~held] != start.theta[~held]).float().mean() > 0.99


@pytest.fixture
def rates(monkeypatch) -> list[np.ndarray]:
    """Learning rates (K,) of each step after the first, which only sets up the eigenbases."""
    seen: list[np.ndarray] = []
    real = Soap.plan

    def plan(self: Soap, rates: np.ndarray) -> tuple:
        seen.extend(rates)
        return real(self, rates)

    monkeypatch.setattr(Soap, "plan", plan)
    return seen


def test_wide_networks_take_smaller_steps(joint_loss, rates):
    largest = []
    for width in (6, 20, 40):
        rates.clear()
        joint_fit(of_widths(width, 5), joint_loss, Schedule(64, 100, 1e-3), 0, quiet, Deadline())
        largest.append(np.max(rates))
    assert largest[1] == largest[0]
    assert largest[2] == pytest.approx(0.25 * largest[0])


def test_a_network_that_owns_little_takes_smaller_steps_and_all_begin_with_small_ones(joint_loss, rates):
    nets = networks()
    joint_loss.active.refresh(nets, TOLERANCE)
    owned = joint_loss.active.owned
    assert owned.sum() == pytest.approx(1)
    joint_fit(nets, joint_loss, Schedule(64, 100, 1e-3), 0, quiet, Deadline())
    share = np.clip(2 * owned, LEAST_RATE_SHARE, 1)
    assert share.min() < 1
    assert len(rates) == 99
    assert rates[0] == pytest.approx(1e-3 * share * 2 / 5, rel=1e-3)  # of the 5 first steps
    assert rates[3] == pytest.approx(1e-3 * share, rel=0.01)
    assert rates[-1].max() < 1e-6


def test_a_deadline_ends_the_joint_fit(joint_loss, rates):
    steps: list[int] = []
    schedule = Schedule(64, 10**7, 1e-3)
    joint_fit(networks(), joint_loss, schedule, 0, lambda step, loss: steps.append(step), Looks(50))
    assert steps[-1] == 50 * CALL_STEPS
    assert rates[-1].max() < 0.01 * np.max(rates)  # the rate has fallen by then


def test_a_network_that_no_sample_pulls_at_is_idle(joint_loss, monkeypatch):
    real = ActiveSet.refresh

    def refresh(self: ActiveSet, nets: object, tolerance: float) -> None:
        real(self, nets, tolerance)
        for active in (self.on_surface.active, self.in_space.active):
            active[:, 1] = False

    monkeypatch.setattr(ActiveSet, "refresh", refresh)
    nets = networks()
    with pytest.raises(IdleNetworkError) as found:
        joint_fit(nets, joint_loss, Schedule(64, 1000, 1e-3), 0, quiet, Deadline())
    assert found.value.number == 1
    # Between rounds all of its weights may be held.
    joint_fit(
        nets,
        joint_loss,
        Schedule(64, 1000, 1e-3),
        0,
        quiet,
        Deadline(),
        torch.zeros(nets.theta.shape, dtype=torch.bool),
    )


@pytest.mark.parametrize(("width", "omega"), [(16, 30), (32, 40), (40, 45)])
def test_wide_networks_have_a_larger_omega(solid, frames, width, omega):
    few = replace(SMALL, steps=3, joint_steps=3, samples=2000, target_resolution=32, clear_cells=8)
    job = job_of(solid, few)
    plan = replace(plan_of(job, frames, [0.5, 0.5]), widths=[width, 8])
    _, fitted, _, _ = fields.fit_needed(job, plan, Deadline())
    assert fitted.omegas == (omega, 30)
    records = records_of(fitted, finest_codes(fitted), frames)
    assert [(r.width, r.omega_first, r.omega_hidden) for r in records] == [(width, omega, omega), (8, 30, 30)]


def test_an_idle_field_is_left_out_and_the_others_are_wider(solid, frames, monkeypatch):
    tried: list[Plan] = []

    def fit(job, plan, start, deadline):
        tried.append(plan)
        if len(plan.frames) == 2:
            raise IdleNetworkError(0)
        return "networks", "loss"

    monkeypatch.setattr(fields, "fit_singly", lambda job, plan, deadline: ("start", 0.0))
    for module in (fields, trials):
        monkeypatch.setattr(module, "fit_jointly", fit)
    job = job_of(solid, replace(SMALL, target_size=4096))
    first = plan_of(job, frames[:2], [0.3, 0.7])
    plan, *rest = fields.fit_needed(job, first, Deadline())
    assert rest == ["networks", "loss", 0.0]
    assert plan is tried[1]
    assert plan.frames == [frames[1]]
    assert plan.shares == [0.7]
    assert plan.widths == widths_for(job.settings, [0.7], 30) > [max(first.widths)]
    # A trial says that such a set of axes is not worth its bytes.
    trial = trials._trial(job, first, 10, Deadline(), networks())
    assert trial.error == np.inf
    assert trial.shares == first.shares
