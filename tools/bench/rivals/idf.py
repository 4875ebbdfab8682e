"""Implicit displacement fields: Yifan, Rahmann, Sorkine-Hornung, "Geometry-Consistent Neural Shape Representation with
Implicit Displacement Fields" (2022).

A smooth SIREN (omega 15) is the base; a second one (omega 60) says how far a point is moved along the base's normal
before the base is asked. The displacement is at most 0.05 and fades away from the base's surface. The base is fitted
alone at first, the whole afterwards. The paper knows points with normals and no distances, and fits by the eikonal
equation; here both are fitted to exact signed distances, in L1, as the other rivals are.
"""

from __future__ import annotations

import math

import torch

from .networks import Network, Sines, widest
from .samples import Samples

LAYERS = 4
BASE_OMEGA, DETAIL_OMEGA = 15.0, 60.0
MOST = 0.05  # alpha: bound of the displacement
FADE = 0.02  # nu: distance at which the displacement is halved
BASE_SHARE = 0.2  # of the training, over which the weight goes from the base to the whole


class Idf(Network):
    steps = 2600
    rate = 1e-3

    def __init__(self, parameters: int) -> None:
        super().__init__()
        width = widest(parameters, 2, LAYERS)
        self.base = Sines(width, LAYERS, BASE_OMEGA)
        self.detail = Sines(width, LAYERS, DETAIL_OMEGA)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return self._both(points)[1]

    def _both(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N,) distances of the base alone, and with the displacement."""
        with torch.enable_grad():
            x = points.detach().requires_grad_()
            base = self.base(x)
            (gradient,) = torch.autograd.grad(base.sum(), x, create_graph=self.training)
        normal = torch.nn.functional.normalize(gradient, dim=1)
        fading = 1 / (1 + (base / FADE) ** 4)
        moved = MOST * torch.tanh(self.detail(points)) * fading
        return base, self.base(points + moved[:, None] * normal)

    def loss(self, points: torch.Tensor, distances: torch.Tensor, done: float) -> torch.Tensor:
        early = (1 + math.cos(math.pi * min(1.0, done / BASE_SHARE))) / 2
        base, both = self._both(points)
        return (early * (base - distances).abs() + (1 - early) * (both - distances).abs()).mean()


def build(samples: Samples, parameters: int, level: int) -> Network:
    return Idf(parameters)
