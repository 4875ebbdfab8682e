"""The paper's loss on a field's heights, and its optimiser."""

from __future__ import annotations

import numpy as np
import torch

from ..dhf.fit.single import Images, Step, draw
from ..dhf.fit.targets import HeightTargets
from ..dhf.network.siren import Networks, forward

TILE_SIDE = 16  # pixels along the side of the tiles that the loss is computed on


class TileLoss:
    """L1 on heights, hinge, and L1 on the Laplacians of the height images, on random tiles of the images."""

    def __init__(self, t: HeightTargets, batch: int, margin: float, laplacian: float) -> None:
        """margin: C; outside the silhouette the far height is to be this much below the near one. laplacian: weight of
        the loss on the Laplacians."""
        self._images, self._margin, self._weight = Images(t), margin, laplacian
        self._laplacians = torch.from_numpy(np.stack([t.laplacian_near.ravel(), t.laplacian_far.ravel()], axis=1))
        self._laplacian_known = torch.from_numpy(t.laplacian_known.ravel()).float()
        self._tiles = max(1, batch // TILE_SIDE**2)
        nu, nv = t.hit.shape
        self._side = min(TILE_SIDE, nu, nv)
        span = torch.arange(self._side)
        self._offsets = span[:, None] * nv + span

    def __call__(self, network: Networks, generator: torch.Generator) -> torch.Tensor:
        im, (nu, nv) = self._images, self._images.shape
        u = draw(nu - self._side + 1, self._tiles, generator)
        v = draw(nv - self._side + 1, self._tiles, generator)
        at = (u * nv + v)[:, None, None] + self._offsets
        y = forward(network, 0, im.uv[at])
        error = ((y - im.heights[at]).abs() * im.known[at]).sum(dim=-1)
        hinge = torch.relu(y[..., 1] - y[..., 0] + self._margin) * (1 - im.hit[at])
        middle = at[:, 1:-1, 1:-1]
        laplacian = y[:, 2:, 1:-1] + y[:, :-2, 1:-1] + y[:, 1:-1, 2:] + y[:, 1:-1, :-2] - 4 * y[:, 1:-1, 1:-1]
        smooth = (laplacian - self._laplacians[middle]).abs().sum(dim=-1) * self._laplacian_known[middle]
        return error.mean() + hinge.mean() + self._weight * smooth.mean()


def adam(network: Networks) -> Step:
    """Make Adam's step: Kingma and Ba, "Adam: A Method for Stochastic Optimization" (2015)."""
    optimiser = torch.optim.Adam([network.theta])

    def step(gradient: torch.Tensor, rate: float) -> None:
        optimiser.param_groups[0]["lr"] = rate
        network.theta.grad = gradient
        optimiser.step()

    return step
