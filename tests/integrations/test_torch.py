"""The torch module against the numpy decoder."""

from __future__ import annotations

import analytic
import numpy as np
import pytest
import surfaces
import torch
from analytic import ABOUT_Y_90, waves

from cndhf_codec import load
from cndhf_codec.errors import OptionError
from cndhf_codec.integrations.torch import CndhfModule


@pytest.fixture(params=["waves", "fitted"])
def model(request, golden):
    if request.param == "fitted":
        return load(golden / "encoded.cndhf")
    return analytic.model(waves(1), waves(2, ABOUT_Y_90, fold=3), centre=(1e5, 6, 7), scale=3)


@pytest.fixture
def points(model):
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (5000, 3))
    return points * model.container.scale + model.container.centre


def test_f_and_its_gradient(model, points):
    f, gradient = model.implicit(points, gradient=True)
    x = torch.tensor(points.reshape(50, 100, 3), requires_grad=True)
    out = CndhfModule(model)(x)
    assert (out.shape, out.dtype) == ((50, 100), torch.float32)
    np.testing.assert_allclose(out.detach().numpy().ravel(), f, atol=1e-5 * model.container.scale)
    out.sum().backward()
    off = np.abs(x.grad.numpy().reshape(-1, 3) - gradient).max(axis=1)
    assert np.median(off) < 1e-5
    assert (off > 1e-2).mean() < 1e-3  # two sides of a crease


def test_heights(model):
    uv = np.random.default_rng(0).uniform(-1.2, 1.2, (20, 30, 2)).astype(np.float32)
    module = CndhfModule(model)
    for i in range(len(model.container.dhfs)):
        np.testing.assert_allclose(
            module.heights(i, torch.tensor(uv)).detach().numpy(), model.heights(i, uv), atol=1e-5
        )
    np.testing.assert_allclose(
        module.heights(0, torch.tensor(uv, dtype=torch.float64)).detach().numpy(), model.heights(0, uv), atol=1e-5
    )
    with pytest.raises(OptionError, match=r"\(\.\.\., 2\)"):
        module.heights(0, torch.zeros(4, 3))
    with pytest.raises(OptionError, match="no DHF 2"):
        module.heights(2, torch.tensor(uv))
    with pytest.raises(OptionError, match=r"\(\.\.\., 3\)"):
        module(torch.tensor(uv))


@pytest.mark.encode
def test_weights_are_trainable(model, points):
    module = CndhfModule(model)
    assert sum(p.numel() for p in module.parameters()) == model.info["parameters"]
    x = torch.tensor(points)
    target = module(x).detach() + 0.01 * model.container.scale  # a thicker solid
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-4)
    losses = []
    for _ in range(20):
        loss = (module(x) - target).abs().mean()
        losses.append(loss.item())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert losses[-1] < 0.8 * losses[0]


def test_double_precision_and_state(model, points):
    module = CndhfModule(model).double()
    assert torch.autograd.gradcheck(lambda x: module(x), torch.tensor(points[:3], requires_grad=True), atol=1e-3)
    other = CndhfModule(model).double()
    other.load_state_dict(module.state_dict())
    assert torch.equal(other(torch.tensor(points)), module(torch.tensor(points)))


def test_wrong_types(model):
    with pytest.raises(OptionError, match="a Model is needed"):
        CndhfModule(3)
    module = CndhfModule(model)
    for wrong in ("abc", None, [[0, 0, 0]], np.zeros((2, 3))):
        with pytest.raises(OptionError, match=r"a tensor of shape \(\.\.\., 3\) is needed"):
            module(wrong)
        with pytest.raises(OptionError, match=r"a tensor of shape \(\.\.\., 2\) is needed"):
            module.heights(0, wrong)
    with pytest.raises(OptionError, match="a whole number is needed"):
        module.heights("0", torch.zeros(2))


def test_a_surface_has_no_networks():
    with pytest.raises(OptionError, match="holds a surface"):
        CndhfModule(surfaces.ball())
