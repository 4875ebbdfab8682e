"""The compiled evaluation against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jointly import networks

from cndhf_codec.encoder.dhf.network import kernel
from cndhf_codec.encoder.dhf.network.siren import forward, heights

pytestmark = pytest.mark.encode


@pytest.mark.parametrize("width", [5, 8, 19])
def test_the_compiled_evaluation_has_torch_s_values_and_gradients(width):
    net = networks(width, count=1)
    theta = net.theta.requires_grad_()
    uv = torch.rand(3001, 2, generator=torch.Generator().manual_seed(0)) * 2 - 1  # not a whole number of tiles
    pull = torch.randn(3001, 2, generator=torch.Generator().manual_seed(1))
    expected = torch.autograd.grad((forward(net, 0, uv) * pull).sum(), theta)[0]
    got = torch.autograd.grad((heights(net, 0, uv) * pull).sum(), theta)[0]
    torch.testing.assert_close(heights(net, 0, uv), forward(net, 0, uv), atol=1e-5, rtol=0)
    torch.testing.assert_close(expected, got, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_the_jacobian_is_torch_s():
    net = networks(width=5, count=1)
    theta = net.theta.requires_grad_()
    uv = torch.rand(300, 2, generator=torch.Generator().manual_seed(0))
    side = np.arange(300) % 2
    jacobian = kernel.jacobian(net.net(0), uv.numpy(), side)
    for i in (0, 1, 150, 299):
        expected = torch.autograd.grad(forward(net, 0, uv)[i, side[i]], theta)[0].numpy()[0]
        np.testing.assert_allclose(jacobian[i], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())
