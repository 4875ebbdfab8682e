"""The networks in torch: weights, initialisation and evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ..format.container import tensor_shapes
from . import kernel


@dataclass(frozen=True, eq=False)
class Networks:
    """K SIRENs of equal shape, 2 inputs and 2 outputs. theta: (K, P) float32, the weights of each in file order."""

    theta: torch.Tensor
    width: int
    hidden_layers: int  # sine layers after the first
    omega: float

    def __len__(self) -> int:
        return len(self.theta)

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        return tensor_shapes(self.width, self.hidden_layers)

    @property
    def sizes(self) -> list[int]:
        """Weights in each tensor."""
        return [math.prod(s) for s in self.shapes]

    def tensors(self, k: int) -> list[torch.Tensor]:
        """Views of the tensors of network k, shaped as `format.container.tensor_shapes` says."""
        parts = torch.split(self.theta[k], self.sizes)
        return [p.view(s) for p, s in zip(parts, self.shapes, strict=True)]

    def weights(self) -> npt.NDArray[np.float64]:
        """(K, P) copy of theta in float64."""
        return self.theta.detach().cpu().numpy().astype(np.float64)

    def copy(self) -> Networks:
        return replace(self, theta=self.theta.detach().clone())

    @property
    def for_kernel(self) -> tuple[int, int, np.float32]:
        """Width, sine layers and omega, as the functions of `kernel` take them."""
        return self.width, self.hidden_layers + 1, np.float32(self.omega)


def stacked(networks: Sequence[Networks]) -> Networks:
    """All networks in one; they have equal shapes."""
    return replace(networks[0], theta=torch.cat([n.theta for n in networks]))


def initialise(width: int, hidden_layers: int, omega: float, generator: torch.Generator) -> Networks:
    """One random network as in Sitzmann et al., "Implicit Neural Representations with Periodic Activation
    Functions" (2020): first layer U(+-1 / inputs), others U(+-sqrt(6 / inputs) / omega)."""
    parts, inputs = [], 0
    for k, shape in enumerate(tensor_shapes(width, hidden_layers)):
        inputs = shape[1] if len(shape) == 2 else inputs  # a bias follows its matrix
        weight_limit = 1 / inputs if k == 0 else math.sqrt(6 / inputs) / omega
        limit = 1 / math.sqrt(inputs) if len(shape) == 1 else weight_limit
        parts.append((torch.rand(math.prod(shape), generator=generator) * 2 - 1) * limit)
    return Networks(torch.cat(parts)[None], width, hidden_layers, omega)


def heights(networks: Networks, k: int, uv: torch.Tensor) -> torch.Tensor:
    """(N, 2) -> (N, 2): near and far height of network k, differentiable in theta. Compiled on the CPU."""
    if uv.device.type == "cpu":
        return _Heights.apply(uv.contiguous(), networks.theta[k], *networks.for_kernel)
    return forward(networks, k, uv)


def forward(networks: Networks, k: int, uv: torch.Tensor) -> torch.Tensor:
    """(..., 2) -> (..., 2): near and far height of network k, by torch's own differentiation."""
    tensors, x = networks.tensors(k), uv
    for at in range(0, len(tensors) - 2, 2):
        x = torch.sin(networks.omega * torch.nn.functional.linear(x, tensors[at], tensors[at + 1]))
    return torch.nn.functional.linear(x, tensors[-2], tensors[-1])


class _Heights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, uv: torch.Tensor, theta: torch.Tensor, width: int, layers: int, omega: np.float32) -> Any:
        ctx.save_for_backward(uv, theta)
        ctx.shape = (width, layers, omega)
        return torch.from_numpy(kernel.heights(theta.detach().numpy(), width, layers, omega, uv.numpy()))

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        uv, theta = ctx.saved_tensors
        g = np.ascontiguousarray(gradient.numpy())
        width, layers, omega = ctx.shape
        out = kernel.heights_gradient(theta.detach().numpy(), width, layers, omega, uv.numpy(), g)
        return None, torch.from_numpy(out), None, None, None
