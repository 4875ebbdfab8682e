"""The optimiser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from jointly import networks, of_widths, used

from cndhf_codec.encoder.dhf.network.siren import initialise
from cndhf_codec.encoder.dhf.network.soap import Soap

pytestmark = pytest.mark.encode


def test_soap_rotates_and_finds_the_minimum():
    # Strongly coupled least squares on every hidden matrix: plain gradients crawl.
    nets = networks(width=6)
    rng = torch.Generator().manual_seed(0)
    mix = torch.randn(6, 6, generator=rng) * torch.logspace(0, -2, 6)
    target = torch.randn(nets.theta.shape, generator=rng)
    optimiser = Soap(nets)

    def loss(theta: torch.Tensor) -> torch.Tensor:
        of = replace(nets, theta=theta - target)
        errors = [e for k in range(len(nets)) for e in of.tensors(k) if e.dim() == 2]
        return sum(((mix @ e if len(e) == 6 else e) ** 2).sum() for e in errors)

    start = loss(nets.theta)
    for step in range(400):
        theta = nets.theta.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(loss(theta), theta)
        optimiser.step(gradient, 0.03 * (1 - step / 400))
    assert loss(nets.theta) < 1e-3 * start


@pytest.mark.parametrize(("width", "steps"), [(9, 20), (24, 20), (30, 8.2), (60, 4)])
def test_soap_forgets_sooner_in_wide_networks(width, steps):
    assert 1 / Soap(networks(width=width)).state.decay == pytest.approx(steps, abs=0.01)


def test_each_network_steps_at_its_own_rate():
    nets = networks(count=3)
    before, optimiser = nets.theta.clone(), Soap(nets)
    gradient = torch.randn(nets.theta[:1].shape, generator=torch.Generator().manual_seed(0)).expand(3, -1)
    for _ in range(2):
        optimiser.step(gradient, np.array([1e-3, 5e-4, 2e-4]))
    lengths = (nets.theta - before).norm(dim=1)
    torch.testing.assert_close(lengths / lengths[0], torch.tensor([1, 0.5, 0.2]), rtol=1e-3, atol=0)


def test_soap_bears_gradients_that_are_zero_or_nearly():
    nets = networks(width=6)
    start = nets.theta.clone()
    optimiser = Soap(nets)
    rng = torch.Generator().manual_seed(0)
    for step in range(100):
        gradient = torch.randn(start.shape, generator=rng) * (1e-18 if step % 3 else 1e-22)
        gradient[torch.rand(start.shape, generator=rng) < 0.9] = 0  # most weights are held
        gradient[:, 20:200] = 0
        optimiser.step(gradient, 1e-3)
    assert torch.isfinite(nets.theta).all()
    assert torch.equal(nets.theta[:, 40:150], start[:, 40:150])


def test_soap_steps_networks_of_any_widths_as_it_would_each():
    together = of_widths(7, 12)
    alone = [initialise(w, 5, 30.0, torch.Generator().manual_seed(k)) for k, w in enumerate((7, 12))]
    optimisers = Soap(together), [Soap(a) for a in alone]
    rng = torch.Generator().manual_seed(1)
    for _ in range(25):
        gradient = torch.randn(together.theta.shape, generator=rng) * torch.from_numpy(used(together))
        optimisers[0].step(gradient, 1e-3)
        for k, one in enumerate(optimisers[1]):
            one.step(gradient[k : k + 1, : alone[k].counts[0]], 1e-3)
    for k in range(2):
        torch.testing.assert_close(together.row(k), alone[k].row(0), rtol=0, atol=2e-5)
