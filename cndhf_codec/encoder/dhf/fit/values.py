"""Evaluate the fields at many points: how far each point is inside each double height field."""

from __future__ import annotations

from typing import NamedTuple

import torch

from ...thread_pool import ThreadPool
from ..network.siren import Networks, heights

POINTS_PER_CALL = 2**15  # that a thread evaluates at a time


class FieldDistances(NamedTuple):
    """How far points are from the two heights of a field.

    uv: (N, 2) where the network is evaluated. above: far - z, (N,). below: z - near, (N,). The lesser of the two is the
    field's value.
    """

    uv: torch.Tensor
    above: torch.Tensor
    below: torch.Tensor


def field_distances(networks: Networks, k: int, points: torch.Tensor, box: torch.Tensor) -> FieldDistances:
    """Evaluate field k at points (N, 3) in its frame. box: (3, 2) its domain box."""
    uv = torch.minimum(torch.maximum(points[:, :2], box[:2, 0]), box[:2, 1])
    y = heights(networks, k, uv)
    return FieldDistances(uv, y[:, 1] - points[:, 2], points[:, 2] - y[:, 0])


def field_values(networks: Networks, points: torch.Tensor, boxes: torch.Tensor, pool: ThreadPool) -> torch.Tensor:
    """(N, K): the values min(far - z, z - near) of all fields at points (K, N, 3) in their frames."""

    def part(at: int) -> torch.Tensor:
        values = []
        for k in range(len(networks)):
            sides = field_distances(networks, k, points[k, at : at + POINTS_PER_CALL], boxes[k])
            values.append(torch.minimum(sides.above, sides.below))
        return torch.stack(values, dim=1)

    with torch.no_grad():
        return torch.cat(pool.map(part, range(0, points.shape[1], POINTS_PER_CALL)))
