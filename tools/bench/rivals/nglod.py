"""NGLOD: Takikawa et al., "Neural Geometric Level of Detail" (2021).

Features stand at the corners of the voxels that the surface passes, in levels of an octree. At a point they are
interpolated trilinearly, summed over levels up to one, and decoded to a signed distance by a network with one hidden
layer. All levels are trained at once, each on the squared error of its sum; a file has the last. One decoder serves all
levels, and features are 16 wide: with levels from 2 on and 128 hidden units this has the parameters that CN-DHF
prints for NGLOD.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch.nn.functional import embedding_bag

from .networks import Network
from .samples import Samples

FEATURES = 16
HIDDEN = 128
FIRST = 2  # level of the coarsest voxels: 2^2 along each side of the cube [-1, 1]^3
DEVIATION = 0.01  # of the features at first


class Octree(torch.nn.Module):
    """The voxels of levels FIRST to `last` that the surface passes, and the corners of each level, numbered from 1.

    0 is a corner that no such voxel has.
    """

    def __init__(self, surface: np.ndarray, last: int) -> None:
        super().__init__()
        self.levels = range(FIRST, last + 1)
        self.occupied, self.corners, self.counts = [], [], []
        for level in self.levels:
            cells = 2**level
            at = np.clip(((surface + 1) / 2 * cells).astype(np.int64), 0, cells - 1)
            occupied = np.zeros((cells,) * 3, dtype=bool)
            occupied[tuple(at.T)] = True
            used = np.zeros((cells + 1,) * 3, dtype=bool)
            for offset in np.ndindex(2, 2, 2):
                used[tuple(slice(o, o + cells) for o in offset)] |= occupied
            self.occupied.append(torch.from_numpy(occupied))
            self.counts.append(int(used.sum()))
            self.corners.append(torch.from_numpy(np.cumsum(used) * used.ravel()))

    def covers(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) whether points (N, 3) are in a voxel of the last level."""
        return self._within(points, len(self.occupied) - 1)

    def _within(self, points: torch.Tensor, k: int) -> torch.Tensor:
        cells = len(self.occupied[k])
        at = ((points + 1) / 2 * cells).long()
        ok = ((at >= 0) & (at < cells)).all(dim=1)
        return ok & self.occupied[k][at.clamp(0, cells - 1).unbind(1)]

    def sums(self, points: torch.Tensor, tables: list[torch.Tensor]) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Per level: which points (N,) are in its voxels, and features (N, F) summed over the levels up to it.

        tables: per level (corners + 1, F); the first row is zero.
        """
        total: torch.Tensor | float = 0.0
        out = []
        for k, table in enumerate(tables):
            cells = len(self.occupied[k])
            x = ((points + 1) / 2 * cells).clamp(0, cells)
            low = x.long().clamp(max=cells - 1)
            part = x - low
            base = (low[:, 0] * (cells + 1) + low[:, 1]) * (cells + 1) + low[:, 2]
            index, weight = [], []
            for a, b, c in np.ndindex(2, 2, 2):
                index.append(base + (a * (cells + 1) + b) * (cells + 1) + c)
                sides = [part[:, n] if o else 1 - part[:, n] for n, o in enumerate((a, b, c))]
                weight.append(sides[0] * sides[1] * sides[2])
            rows = self.corners[k][torch.stack(index, dim=1)]
            total = total + embedding_bag(rows, table, mode="sum", per_sample_weights=torch.stack(weight, dim=1))
            out.append((self._within(points, k), total))
        return out

    def packed(self) -> bytes:
        """Eight bits for each occupied voxel of a level but the last: which of its children are occupied."""
        data = [np.packbits(self.occupied[0].numpy()).tobytes()]
        for above, below in pairwise(self.occupied):
            n = len(above)
            children = below.numpy().reshape(n, 2, n, 2, n, 2).transpose(0, 2, 4, 1, 3, 5).reshape(n, n, n, 8)
            data.append(np.packbits(children[above.numpy()]).tobytes())
        return b"".join(data)


class Nglod(Network):
    steps = 6000
    rate = 1e-2

    def __init__(self, octree: Octree) -> None:
        super().__init__()
        self.octree = octree
        self._store(octree.counts)
        self.decoder = torch.nn.Sequential(
            torch.nn.Linear(FEATURES, HIDDEN), torch.nn.ReLU(), torch.nn.Linear(HIDDEN, 1)
        )

    def _store(self, counts: list[int]) -> None:
        self.features = torch.nn.ParameterList(DEVIATION * torch.randn(n, FEATURES) for n in counts)

    def tables(self) -> list[torch.Tensor]:
        return [torch.nn.functional.pad(f, (0, 0, 1, 0)) for f in self.features]

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return self.decoder(self.octree.sums(points, self.tables())[-1][1])[:, 0]

    def covers(self, points: torch.Tensor) -> torch.Tensor:
        return self.octree.covers(points)

    def loss(self, points: torch.Tensor, distances: torch.Tensor, done: float) -> torch.Tensor:
        total = torch.zeros(())
        for within, features in self.octree.sums(points, self.tables()):
            off = self.decoder(features)[:, 0] - distances
            total = total + off[within].square().sum() / len(points)
        return total

    def whole(self) -> bytes:
        return self.octree.packed()


def build(samples: Samples, parameters: int, level: int) -> Network:
    return Nglod(Octree(samples.surface, FIRST + level - 1))
