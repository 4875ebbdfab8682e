"""The networks in torch: weights, initialisation and evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ....arrays import F64, I64
from ....format.container import parameter_count, tensor_shapes
from . import kernel


@dataclass(frozen=True, eq=False)
class Networks:
    """K SIRENs with equally many layers, 2 inputs and 2 outputs.

    theta: (K, P) float32, the weights of each in file order; rows of narrower networks end in zeros.
    """

    theta: torch.Tensor
    widths: tuple[int, ...]
    hidden_layers: int  # sine layers after the first
    omegas: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.theta)

    def shapes(self, k: int) -> list[tuple[int, ...]]:
        """Shapes of the tensors of network k."""
        return tensor_shapes(self.widths[k], self.hidden_layers)

    def sizes(self, k: int) -> list[int]:
        """Number of weights in each tensor of network k."""
        return [math.prod(s) for s in self.shapes(k)]

    def starts(self, k: int) -> I64:
        """Where each tensor begins in the row of network k."""
        return np.cumsum([0, *self.sizes(k)[:-1]])

    @property
    def counts(self) -> list[int]:
        """Number of weights of each network."""
        return [parameter_count(w, self.hidden_layers) for w in self.widths]

    def row(self, k: int) -> torch.Tensor:
        """(P_k,): the weights of network k, a view."""
        return self.theta[k, : self.counts[k]]

    def tensors(self, k: int) -> list[torch.Tensor]:
        """Views of the tensors of network k, shaped as `format.container.tensor_shapes` says."""
        parts = torch.split(self.row(k), self.sizes(k))
        return [p.view(s) for p, s in zip(parts, self.shapes(k), strict=True)]

    def weights(self) -> F64:
        """(K, P) copy of theta in float64."""
        return self.theta.detach().numpy().astype(np.float64)

    def copy(self) -> Networks:
        return replace(self, theta=self.theta.detach().clone())

    def net(self, k: int) -> kernel.Net:
        """Network k for the functions of `kernel`; its weights are a view."""
        return kernel.Net(
            self.row(k).detach().numpy(), self.widths[k], self.hidden_layers + 1, np.float32(self.omegas[k])
        )

    def kernel_shapes(self) -> kernel.Shapes:
        return kernel.Shapes(
            np.array(self.widths), np.array(self.counts), self.hidden_layers + 1, np.array(self.omegas, np.float32)
        )


def stacked(networks: Sequence[Networks]) -> Networks:
    """Join networks, which must have equally many layers."""
    longest = max(n.theta.shape[1] for n in networks)
    return Networks(
        torch.cat([torch.nn.functional.pad(n.theta, (0, longest - n.theta.shape[1])) for n in networks]),
        tuple(w for n in networks for w in n.widths),
        networks[0].hidden_layers,
        tuple(omega for n in networks for omega in n.omegas),
    )


def initialise(width: int, hidden_layers: int, omega: float, generator: torch.Generator) -> Networks:
    """Make one random network as in Sitzmann et al., "Implicit Neural Representations with Periodic Activation
    Functions" (2020): first layer U(+-1 / inputs), others U(+-sqrt(6 / inputs) / omega)."""
    parts, inputs = [], 0
    for k, shape in enumerate(tensor_shapes(width, hidden_layers)):
        inputs = shape[1] if len(shape) == 2 else inputs  # a bias follows its matrix
        weight_limit = 1 / inputs if k == 0 else math.sqrt(6 / inputs) / omega
        limit = 1 / math.sqrt(inputs) if len(shape) == 1 else weight_limit
        parts.append((torch.rand(math.prod(shape), generator=generator) * 2 - 1) * limit)
    return Networks(torch.cat(parts)[None], (width,), hidden_layers, (omega,))


def heights(networks: Networks, k: int, uv: torch.Tensor) -> torch.Tensor:
    """(N, 2) -> (N, 2): near and far height of network k, compiled; differentiable in theta."""
    return _Heights.apply(uv.contiguous(), networks.row(k), networks.net(k))


def forward(networks: Networks, k: int, uv: torch.Tensor) -> torch.Tensor:
    """(..., 2) -> (..., 2): near and far height of network k, by torch's own functions."""
    tensors, x = networks.tensors(k), uv
    for at in range(0, len(tensors) - 2, 2):
        x = torch.sin(networks.omegas[k] * torch.nn.functional.linear(x, tensors[at], tensors[at + 1]))
    return torch.nn.functional.linear(x, tensors[-2], tensors[-1])


class _Heights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, uv: torch.Tensor, theta: torch.Tensor, net: kernel.Net) -> Any:
        ctx.save_for_backward(uv, theta)
        ctx.net = net
        return torch.from_numpy(kernel.heights(net, uv.numpy()))

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        uv, theta = ctx.saved_tensors
        net = ctx.net._replace(theta=theta.detach().numpy())
        out = kernel.heights_gradient(net, uv.numpy(), np.ascontiguousarray(gradient.numpy()))
        return None, torch.from_numpy(out), None
