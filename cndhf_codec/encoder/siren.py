"""The network in torch: initialisation and evaluation, tensors in the order of the file format."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ..format.container import tensor_shapes

TILE = 1024  # rows evaluated at once on the CPU: their activations stay in the cache


def initialise(width: int, hidden_layers: int, omega: float, generator: torch.Generator) -> list[torch.Tensor]:
    """Random tensors as in Sitzmann et al., "Implicit Neural Representations with Periodic Activation
    Functions" (2020): first layer U(+-1 / inputs), others U(+-sqrt(6 / inputs) / omega)."""
    tensors, inputs = [], 0
    for k, shape in enumerate(tensor_shapes(width, hidden_layers)):
        inputs = shape[1] if len(shape) == 2 else inputs  # a bias follows its matrix
        weight_limit = 1 / inputs if k == 0 else math.sqrt(6 / inputs) / omega
        limit = 1 / math.sqrt(inputs) if len(shape) == 1 else weight_limit
        tensors.append((torch.rand(shape, generator=generator) * 2 - 1) * limit)
    return tensors


def heights(tensors: list[torch.Tensor], uv: torch.Tensor, omega: float) -> torch.Tensor:
    """(N, 2) -> (N, 2): near and far height, differentiable in the tensors.

    On the CPU a backward pass written for this network is used, tile by tile: about twice as fast as torch's.
    """
    if uv.device.type == "cpu":
        return _TiledSiren.apply(uv, omega, *tensors)
    return forward(tensors, uv, omega)


def forward(tensors: list[torch.Tensor], uv: torch.Tensor, omega: float) -> torch.Tensor:
    """(..., 2) -> (..., 2): near and far height, by torch's own differentiation."""
    x = uv
    for k in range(0, len(tensors) - 2, 2):
        x = torch.sin(omega * torch.nn.functional.linear(x, tensors[k], tensors[k + 1]))
    return torch.nn.functional.linear(x, tensors[-2], tensors[-1])


class Trace:
    """One forward pass in numpy that keeps what a backward pass needs."""

    def __init__(self, tensors: list[npt.NDArray[np.float32]], uv: npt.NDArray[np.float32], omega: float) -> None:
        self.tensors, self.omega = tensors, omega
        self.matrices = [np.float32(omega) * W for W in tensors[0:-2:2]]
        self.inputs = [uv]  # of every layer
        self.slopes = []  # cosines of every sine layer
        x = uv
        for W, b in zip(self.matrices, tensors[1:-2:2], strict=True):
            z = x @ W.T
            z += np.float32(omega) * b
            self.slopes.append(np.cos(z))
            x = np.sin(z, out=z)
            self.inputs.append(x)
        self.heights = x @ tensors[-2].T + tensors[-1]

    def gradients(self, g: npt.NDArray[np.float32]) -> list[npt.NDArray[np.float32]]:
        """Gradient of sum(g * heights) in every tensor. Rows of g that are zero are left out of the work."""
        rows: Any = np.flatnonzero(g.any(axis=1))
        rows = slice(None) if len(rows) > 0.8 * len(g) else rows
        g = g[rows]
        out: list[npt.NDArray[np.float32]] = [g.sum(axis=0), g.T @ self.inputs[-1][rows]]
        g = g @ self.tensors[-2]
        for k in range(len(self.slopes) - 1, -1, -1):
            g = g * self.slopes[k][rows]
            out += [g.sum(axis=0) * self.omega, g.T @ self.inputs[k][rows] * self.omega]
            if k:
                g = g @ self.matrices[k]
        return out[::-1]

    def jacobian(self, side: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """(N, parameters): gradient of height `side` (0 near, 1 far) of each row in all weights, file order."""
        n = len(side)
        g = np.zeros((n, 2), dtype=np.float32)
        g[np.arange(n), side] = 1
        blocks = [g, (g[:, :, None] * self.inputs[-1][:, None, :]).reshape(n, -1)]
        g = g @ self.tensors[-2]
        for k in range(len(self.slopes) - 1, -1, -1):
            g = g * self.slopes[k] * np.float32(self.omega)
            blocks += [g, (g[:, :, None] * self.inputs[k][:, None, :]).reshape(n, -1)]
            g = g @ self.tensors[2 * k]
        return np.concatenate(blocks[::-1], axis=1)


class _TiledSiren(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, uv: torch.Tensor, omega: float, *tensors: torch.Tensor) -> Any:
        arrays = [t.detach().numpy() for t in tensors]
        points = uv.numpy()
        tiles = [points[at : at + TILE] for at in range(0, len(points), TILE)]
        # A fit that diverges overflows here; its loss is looked at, and tells.
        with np.errstate(over="ignore", invalid="ignore"):
            ctx.traces = [Trace(arrays, tile, omega) for tile in tiles]
        return torch.from_numpy(np.concatenate([t.heights for t in ctx.traces]))

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:
        g = gradient.numpy()
        total: list[npt.NDArray[np.float32]] = []
        with np.errstate(over="ignore", invalid="ignore"):
            for k, trace in enumerate(ctx.traces):
                gradients = trace.gradients(g[k * TILE : (k + 1) * TILE])
                total = gradients if k == 0 else [a + b for a, b in zip(total, gradients, strict=True)]
        return (None, None, *(torch.from_numpy(a) for a in total))
