"""VQAD: Takikawa et al., "Variable Bitrate Neural Fields" (2022).

NGLOD's octree, whose corners have no features of their own but the number of one in a codebook; each level has its own.
In training each corner has a logit per entry: the entry of the largest is taken, and its gradient is that of the
softmax (straight through). In the second half of the training the numbers stay. A file has them, in 4 bits, and the
codebooks. The logits count as parameters, as they seem to in CN-DHF's table.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import one_hot, pad

from .networks import Network
from .nglod import FEATURES, FIRST, Nglod, Octree
from .samples import Samples

BITS = 4
# On a sphere, after 800 steps: 0.1 for both and numbers that stay 0.005 to 0.009 off, numbers that go on changing 0.012
# to 0.021, codebooks of deviation 0.01 0.024 to 0.026, and soft numbers, sharpened and made whole at the end, 0.04.
SPREAD = 0.1  # deviation of logits and codebooks at first
CHANGING = 0.5  # share of the training in which numbers change


class Vqad(Nglod):
    def _store(self, counts: list[int]) -> None:
        self.logits = torch.nn.ParameterList(SPREAD * torch.randn(n, 2**BITS) for n in counts)
        self.codebooks = torch.nn.ParameterList(SPREAD * torch.randn(2**BITS, FEATURES) for _ in counts)

    def tables(self) -> list[torch.Tensor]:
        out = []
        for logits, codebook in zip(self.logits, self.codebooks, strict=True):
            chosen = one_hot(logits.argmax(dim=1), 2**BITS).float()
            if logits.requires_grad:
                soft = torch.softmax(logits, dim=1)
                chosen = chosen + soft - soft.detach()
            out.append(pad(chosen @ codebook, (0, 0, 1, 0)))
        return out

    def loss(self, points: torch.Tensor, distances: torch.Tensor, done: float) -> torch.Tensor:
        self.logits.requires_grad_(done < CHANGING)
        return super().loss(points, distances, done)

    def weights(self) -> list[torch.nn.Parameter]:
        return [*self.codebooks, *self.decoder.parameters()]

    def whole(self) -> bytes:
        numbers = np.concatenate([logits.detach().argmax(dim=1).numpy() for logits in self.logits])
        bits = (numbers[:, None] >> np.arange(BITS)) & 1
        return super().whole() + np.packbits(bits.astype(bool)).tobytes()


def build(samples: Samples, parameters: int, level: int) -> Network:
    return Vqad(Octree(samples.surface, FIRST + level - 1))
