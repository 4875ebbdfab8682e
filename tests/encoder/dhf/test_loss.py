"""The joint loss: its gradient, its steps, its threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from jointly import networks, of_widths, used

from cndhf_codec.encoder.dhf.fit import loss as loss_module
from cndhf_codec.encoder.dhf.fit.active_set import TOLERANCE
from cndhf_codec.encoder.dhf.fit.clear_space import ClearSpace
from cndhf_codec.encoder.dhf.fit.loss import JointLoss
from cndhf_codec.encoder.dhf.fit.samples import Samples
from cndhf_codec.encoder.dhf.network.soap import Soap
from cndhf_codec.encoder.thread_pool import ThreadPool

pytestmark = pytest.mark.encode


@pytest.mark.parametrize("refreshed", [False, True])
@pytest.mark.parametrize("widths", [(8, 8), (9, 8)])
def test_the_compiled_loss_has_the_gradient_of_its_terms(samples, clear, frames, refreshed, widths):
    nets = of_widths(*widths)
    joint_loss = JointLoss(samples, clear, frames, ThreadPool(1))
    if refreshed:  # then networks that have no say in a sample are left out
        joint_loss.active.refresh(nets, TOLERANCE)
        assert joint_loss.active.on_surface.active.mean() < 0.9
        assert joint_loss.active._say.float().mean() < 0.9
    batch = joint_loss.active.draw_steps(1500, 1100, 1, np.random.default_rng(0))
    theta = nets.theta.clone().requires_grad_()
    cost = joint_loss.terms(replace(nets, theta=theta), *joint_loss.active.rows(batch)).cost
    loss = cost[:1500].mean() + cost[1500:].sum() / 1100
    (expected,) = torch.autograd.grad(loss, theta)
    got, value = joint_loss.gradient(nets, batch)
    assert value == pytest.approx(loss.item(), rel=1e-5)
    torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))
    assert (got.abs().max(dim=1).values > 0).all()
    assert not got[torch.from_numpy(~used(nets))].any()


def test_shares_of_the_loss(joint_loss):
    nets = networks()
    shares = joint_loss.shares(nets)
    assert sum(shares) == pytest.approx(1)
    surface, space = (torch.arange(n) for n in (joint_loss.store.n_surface, joint_loss.store.n_space))
    with torch.no_grad():
        terms = joint_loss.terms(nets, surface, space)
    weight = torch.cat([torch.full((len(part),), 1 / len(part)) for part in (surface, space)])
    own = terms.field == 0
    assert shares[0] == pytest.approx(float((terms.cost * weight)[own].sum() / (terms.cost * weight).sum()), rel=1e-4)


def some_steps(samples: Samples, clear: ClearSpace, frames: list, threads: int) -> tuple:
    """Two networks of different widths after twenty steps in threads, with some weights held: theta, loss, pulled."""
    nets = of_widths(9, 8)
    held = torch.zeros(nets.theta.shape, dtype=torch.bool)
    held[0, 100:300] = True
    with ThreadPool(threads) as pool:
        joint_loss = JointLoss(samples, clear, frames, pool)
        optimiser = Soap(nets)
        batches = joint_loss.active.draw_steps(1500, 1100, 21, np.random.default_rng(0))
        rates = np.full((21, 2), [1e-3, 5e-4])
        joint_loss.descend(nets, optimiser, batches.part(0, 1), rates[:1], held)
        assert optimiser.started
        return nets.theta, *joint_loss.descend(nets, optimiser, batches.part(1, 21), rates[1:], held)


def test_threads_do_not_change_the_steps(samples, clear, frames):
    results = [some_steps(samples, clear, frames, threads) for threads in (1, 2, 3, 7)]
    for theta, loss, pulled in results[1:]:
        assert torch.equal(theta, results[0][0])
        assert loss == results[0][1]
        assert pulled.all()


def test_steps_together_are_steps_one_by_one(samples, clear, frames):
    together, loss, _ = some_steps(samples, clear, frames, 1)
    nets, joint_loss = of_widths(9, 8), JointLoss(samples, clear, frames, ThreadPool(1))
    before, optimiser = nets.theta.clone(), Soap(nets)
    batches = joint_loss.active.draw_steps(1500, 1100, 21, np.random.default_rng(0))
    for s in range(21):
        gradient, one_loss = joint_loss.gradient(nets, batches.part(s, s + 1))
        gradient[0, 100:300] = 0
        optimiser.step(gradient, np.array([1e-3, 5e-4]))
        nets.theta[0, 100:300] = before[0, 100:300]
    assert loss == pytest.approx(one_loss, rel=1e-4)
    torch.testing.assert_close(together, nets.theta, rtol=0, atol=1e-5)
    assert (together - before).abs().max() > 3e-3


def test_a_thread_that_fails_does_not_leave_the_others_waiting(samples, clear, frames, monkeypatch):
    real = loss_module.take_steps

    def failing(me: int, *rest: object) -> None:
        if me == 1:
            raise MemoryError("no room")
        real(me, *rest)

    monkeypatch.setattr(loss_module, "take_steps", failing)
    with pytest.raises(MemoryError, match="no room"):
        some_steps(samples, clear, frames, 2)


def test_an_interrupt_does_not_leave_the_others_waiting(samples, clear, frames, monkeypatch):
    real = ThreadPool.map

    def interrupted(pool: ThreadPool, run: object, threads: object) -> object:
        def part(me: int) -> object:
            if me == 0:
                raise KeyboardInterrupt
            return run(me)

        return real(pool, part, threads)

    monkeypatch.setattr(ThreadPool, "map", interrupted)
    with pytest.raises(KeyboardInterrupt):
        some_steps(samples, clear, frames, 3)
