"""VQAD: Takikawa et al., "Variable Bitrate Neural Fields" (2022).

NGLOD's octree, whose corners have no features of their own but the number of one in a codebook; each level has its own.
In training each corner has a logit per entry, and the feature that their softmax weighs. These soft numbers are what is
measured as trained, for the logits count as parameters in CN-DHF's table. A file has whole numbers, in 4 bits, and the
codebooks: the soft features are grouped (k-means), and the rest is trained further.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import one_hot, pad

from .networks import Network
from .nglod import FEATURES, FIRST, Nglod, Octree
from .samples import Samples

BITS = 4
SPREAD = 0.1  # deviation of logits and codebooks at first
GROUPINGS = 50  # rounds of k-means


class Vqad(Nglod):
    steps = 12_000
    rate = 2e-2

    def _store(self, counts: list[int]) -> None:
        self.logits = torch.nn.ParameterList(SPREAD * torch.randn(n, 2**BITS) for n in counts)
        self.codebooks = torch.nn.ParameterList(SPREAD * torch.randn(2**BITS, FEATURES) for _ in counts)
        self.numbers: list[torch.Tensor] = []  # whole ones, once there are

    def tables(self) -> list[torch.Tensor]:
        shares = [one_hot(n, 2**BITS).float() for n in self.numbers] or [torch.softmax(x, dim=1) for x in self.logits]
        return [pad(s @ codebook, (0, 0, 1, 0)) for s, codebook in zip(shares, self.codebooks, strict=True)]

    def settle(self) -> None:
        self.numbers = []
        with torch.no_grad():
            for table, codebook in zip(self.tables(), self.codebooks, strict=True):
                features = table[1:]
                codebook.copy_(_spread(features, len(codebook)))
                for _ in range(GROUPINGS):
                    number = torch.cdist(features, codebook).argmin(dim=1)
                    count = torch.bincount(number, minlength=2**BITS)[:, None]
                    sums = torch.zeros_like(codebook).index_add_(0, number, features)
                    codebook.copy_(torch.where(count > 0, sums / count.clamp(min=1), codebook))
                self.numbers.append(torch.cdist(features, codebook).argmin(dim=1))
        self.logits.requires_grad_(False)

    def weights(self) -> list[torch.nn.Parameter]:
        return [*self.codebooks, *self.decoder.parameters()]

    def whole(self) -> bytes:
        numbers = torch.cat(self.numbers).numpy()
        bits = (numbers[:, None] >> np.arange(BITS)) & 1
        return super().whole() + np.packbits(bits.astype(bool)).tobytes()


def _spread(features: torch.Tensor, count: int) -> torch.Tensor:
    """Features far from each other: each is the farthest from those before."""
    far = torch.cdist(features, features.mean(dim=0, keepdim=True))[:, 0]
    chosen = []
    for _ in range(count):
        chosen.append(features[far.argmax()])
        far = torch.minimum(far, torch.cdist(features, chosen[-1][None])[:, 0])
    return torch.stack(chosen)


def build(samples: Samples, parameters: int, level: int) -> Network:
    return Vqad(Octree(samples.surface, FIRST + level - 1))
