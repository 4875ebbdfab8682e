"""SIREN on a signed distance: Sitzmann et al., "Implicit Neural Representations with Periodic Activation Functions"
(2020), as CN-DHF compares with it: five hidden layers after the first, omega 30.

The loss is L1 on exact signed distances of points on the surface, near it and in the volume, in place of the eikonal
equation, which stands in for distances that are not known.
"""

from __future__ import annotations

import torch

from .networks import Network, Sines, widest
from .samples import Samples

LAYERS = 6
OMEGA = 30.0


class SirenSdf(Network):
    steps = 8000
    rate = 5e-4

    def __init__(self, parameters: int) -> None:
        super().__init__()
        self.sines = Sines(widest(parameters, 1, LAYERS), LAYERS, OMEGA)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return self.sines(points)

    def loss(self, points: torch.Tensor, distances: torch.Tensor, done: float) -> torch.Tensor:
        return (self(points) - distances).abs().mean()


def build(samples: Samples, parameters: int, level: int) -> Network:
    return SirenSdf(parameters)
