"""The samples of a joint fit, as tensors in the frame of every field, with room for counterexamples."""

from __future__ import annotations

import numpy as np
import torch

from ....arrays import F32, Mask
from ....format.container import fold
from ..frames import Frame
from ..network import kernel
from .samples import Samples

# Evidence for these constants: ADR 015; COUNTEREXAMPLES: 018.
MARGIN = 0.03  # greatest margin by which f must have the right sign (normalised units)
SPACE_WEIGHT = 0.4  # of a space sample; surface samples and counterexamples have 1
DISTANCE_SCALE = 0.02  # times 1 + d / this, at distance d from the surface: floaters cost area times distance
OUTSIDE_BOX_WEIGHT = 10.0  # times as much outside the input's bounding box
COUNTEREXAMPLES = 20_000  # kept of each side, the latest
NO_FIELD = float(kernel.NO_FIELD)


class SampleStore:
    """N surface samples and M space samples for K fields, and after those COUNTEREXAMPLES rows for each side.

    boxes: (K, 3, 2) domain boxes. Surface samples: surface (K, N, 3), seen (N, K), cosine (N, K). Space samples, with
    R = M + 2 COUNTEREXAMPLES rows: space (K, R, 3), excluded (R, K); inside, distance, margin and weight (R,).
    """

    def __init__(self, samples: Samples, frames: list[Frame]) -> None:
        self.n_surface, self.n_space = len(samples.surface), len(samples.space)
        self._frames = frames
        self.boxes = _tensor(np.stack([f.bounds for f in frames]))
        self._rotations = _tensor(np.stack([f.rotation for f in frames])).mT
        self.surface = self._in_frames(samples.surface)
        self.seen = torch.from_numpy(samples.seen)
        self.cosine = _tensor(samples.cosine)
        self._box = _tensor(samples.box)
        self._found = [0, 0]  # number of counterexamples outside and inside, of all searches

        total = self.n_space + 2 * COUNTEREXAMPLES
        self.space = torch.zeros((len(frames), total, 3))
        self.excluded = torch.zeros((total, len(frames)), dtype=torch.bool)
        self.inside = torch.zeros(total, dtype=torch.bool)
        self.distance, self.margin, self.weight = (torch.zeros(total) for _ in range(3))
        self._put(torch.arange(self.n_space), samples.space, samples.excluded, samples.distance, SPACE_WEIGHT)

    @property
    def kept(self) -> list[int]:
        """Number of counterexamples that are kept outside and inside."""
        return [min(n, COUNTEREXAMPLES) for n in self._found]

    def counterexamples(self, side: int) -> torch.Tensor:
        """Rows of the counterexamples of a side."""
        return self.n_space + side * COUNTEREXAMPLES + torch.arange(self.kept[side])

    def add_counterexamples(self, side: int, points: F32, excluded: Mask, distance: F32) -> None:
        """Store points (N, 3) with the truth about them. Where there is no room, they replace the oldest."""
        numbers = (self._found[side] + np.arange(len(points))) % COUNTEREXAMPLES
        rows = torch.from_numpy(self.n_space + side * COUNTEREXAMPLES + numbers)
        self._put(rows, points, excluded, distance, 1.0)
        self._found[side] += len(rows)

    def _put(self, rows: torch.Tensor, points: F32, excluded: Mask, distance: F32, weight: float) -> None:
        self.space[:, rows] = self._in_frames(points)
        self.excluded[rows] = torch.from_numpy(excluded)
        self.inside[rows] = ~self.excluded[rows].any(dim=1)
        self.distance[rows] = _tensor(distance)
        p = _tensor(points)
        outside_box = ((p < self._box[0]) | (p > self._box[1])).any(dim=1)
        by_distance = 1 + self.distance[rows] / DISTANCE_SCALE
        self.weight[rows] = by_distance * torch.where(outside_box, OUTSIDE_BOX_WEIGHT, 1.0) * weight
        # Outside a domain box the solid is empty, whatever the networks say.
        lo, hi = self.boxes[:, None, :, 0], self.boxes[:, None, :, 1]
        beyond = ((self.space[:, rows] < lo) | (self.space[:, rows] > hi)).any(dim=2).any(dim=0)
        margin = (self.distance[rows] / 2).clamp(max=MARGIN)
        self.margin[rows] = margin.masked_fill(beyond & ~self.inside[rows], -NO_FIELD)

    def _in_frames(self, points: F32) -> torch.Tensor:
        """Rotate points (N, 3) into the frame of every field, (K, N, 3), on the side of its mirrors that the network
        describes."""
        uvz = _tensor(points) @ self._rotations
        for x, frame in zip(uvz, self._frames, strict=True):
            fold(x, frame.mirrors)
        return uvz


def _tensor(array: object) -> torch.Tensor:
    return torch.as_tensor(array, dtype=torch.float32)
