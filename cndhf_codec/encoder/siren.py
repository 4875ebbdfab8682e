"""The network in torch: initialisation and forward pass, tensors in the order of the file format."""

from __future__ import annotations

import math

import torch

from ..format.container import tensor_shapes


def initialise(width: int, hidden_layers: int, omega: float, generator: torch.Generator) -> list[torch.Tensor]:
    """Random tensors as in Sitzmann et al., "Implicit Neural Representations with Periodic Activation
    Functions" (2020): first layer U(+-1 / inputs), others U(+-sqrt(6 / inputs) / omega)."""
    tensors, inputs = [], 0
    for k, shape in enumerate(tensor_shapes(width, hidden_layers)):
        inputs = shape[1] if len(shape) == 2 else inputs  # a bias follows its matrix
        if len(shape) == 1:
            limit = 1 / math.sqrt(inputs)
        else:
            limit = 1 / inputs if k == 0 else math.sqrt(6 / inputs) / omega
        tensors.append((torch.rand(shape, generator=generator) * 2 - 1) * limit)
    return tensors


def forward(tensors: list[torch.Tensor], uv: torch.Tensor, omega: float) -> torch.Tensor:
    """(..., 2) -> (..., 2): near and far height."""
    x = uv
    for k in range(0, len(tensors) - 2, 2):
        x = torch.sin(omega * torch.nn.functional.linear(x, tensors[k], tensors[k + 1]))
    return torch.nn.functional.linear(x, tensors[-2], tensors[-1])
