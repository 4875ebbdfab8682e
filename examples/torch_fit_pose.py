"""A model as a differentiable module: find how a scanned part lies, from points on it.

    python examples/torch_fit_pose.py part.cndhf

Points of the surface are turned and shifted; the pose comes back by gradient descent on |f|. Any loss on f or on the
heights can be differentiated so, by points and by the networks' weights.
"""

from __future__ import annotations

import sys

import numpy as np
import torch

import cndhf_codec
from cndhf_codec.integrations.torch import CndhfModule


def rotation(vector: torch.Tensor) -> torch.Tensor:
    """(3,) axis times angle -> (3, 3)."""
    x, y, z = vector
    zero = torch.zeros_like(x)
    cross = torch.stack([torch.stack([zero, -z, y]), torch.stack([z, zero, -x]), torch.stack([-y, x, zero])])
    return torch.linalg.matrix_exp(cross)


def fit_pose(model: cndhf_codec.Model, points: np.ndarray, steps: int = 200) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation (3, 3) and shift (3,) that take points (N, 3) back to the surface, and the mean |f| left."""
    solid = CndhfModule(model).requires_grad_(False)
    scale = model.container.scale
    centre = torch.tensor(model.container.centre)
    cloud = torch.tensor(points)
    turn = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    shift = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([turn, shift], lr=0.005)  # a larger step never settles: |f| has a kink at 0
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        moved = (cloud - centre) @ rotation(turn).T + centre + scale * shift
        loss = solid(moved).abs().mean() / scale
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return rotation(turn).detach().numpy(), scale * shift.detach().numpy(), loss.item() * scale


def surface_points(model: cndhf_codec.Model, n: int, seed: int = 0) -> np.ndarray:
    """Where n random rays towards the centre first meet the surface, (at most n, 3)."""
    centre, scale = np.array(model.info["centre"]), model.info["scale"]
    away = np.random.default_rng(seed).normal(size=(n, 3))
    hits = model.ray_intersect(centre + 4 * scale * away / np.linalg.norm(away, axis=1, keepdims=True), -away)
    return hits.point[np.isfinite(hits.distance)]


def main() -> None:
    if len(sys.argv) != 2:
        raise SystemExit("usage: python examples/torch_fit_pose.py part.cndhf")
    model = cndhf_codec.load(sys.argv[1])
    points = surface_points(model, 2000)
    centre, scale = np.array(model.info["centre"]), model.info["scale"]
    turned = rotation(torch.tensor([0.1, -0.15, 0.08], dtype=torch.float64)).numpy()
    moved = (points - centre) @ turned.T + centre + scale * np.array([0.03, -0.02, 0.04])
    R, shift, left = fit_pose(model, moved)
    back = (moved - centre) @ R.T + centre + shift
    print(f"mean distance of the points from where they were: {np.linalg.norm(back - points, axis=1).mean():.4g}")
    print(f"mean |f| left: {left:.4g}; one normalised unit is {scale:.4g}")


if __name__ == "__main__":
    main()
