"""VQAD: Takikawa et al., "Variable Bitrate Neural Fields" (2022).

NGLOD's octree, whose corners have no features of their own but the number of one in a codebook; each level has its own.
In training each corner has a logit per entry: the entry of the largest is taken, and its gradient is that of the
softmax (straight through). A file has the numbers, of 4 bits, and the codebooks. The logits count as parameters, as
they seem to in CN-DHF's table.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import one_hot, pad

from .networks import Network
from .nglod import DEVIATION, FEATURES, FIRST, Nglod, Octree
from .samples import Samples

BITS = 4
SPREAD = 0.1  # of the logits at first: with 1, a sphere has three times the error


class Vqad(Nglod):
    def _store(self, counts: list[int]) -> None:
        self.logits = torch.nn.ParameterList(SPREAD * torch.randn(n, 2**BITS) for n in counts)
        self.codebooks = torch.nn.ParameterList(DEVIATION * torch.randn(2**BITS, FEATURES) for _ in counts)

    def tables(self) -> list[torch.Tensor]:
        out = []
        for logits, codebook in zip(self.logits, self.codebooks, strict=True):
            soft = torch.softmax(logits, dim=1)
            hard = one_hot(logits.argmax(dim=1), 2**BITS)
            out.append(pad((hard + soft - soft.detach()) @ codebook, (0, 0, 1, 0)))
        return out

    def weights(self) -> list[torch.nn.Parameter]:
        return [*self.codebooks, *self.decoder.parameters()]

    def whole(self) -> bytes:
        numbers = np.concatenate([logits.detach().argmax(dim=1).numpy() for logits in self.logits])
        bits = (numbers[:, None] >> np.arange(BITS)) & 1
        return super().whole() + np.packbits(bits.astype(bool)).tobytes()


def build(samples: Samples, parameters: int, level: int) -> Network:
    return Vqad(Octree(samples.surface, FIRST + level - 1))
