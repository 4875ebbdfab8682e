"""Use network symmetries to make biases cost fewer bytes.

Networks that differ only in the order, sign and phase of their neurons are the same function. A neuron is
sin(omega (w x + b)). It becomes its own negative when w and b change their signs, or when pi / omega is added to b; the
next layer's weights for it then change their signs.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from ....format.container import Symbols
from ..network.siren import Networks


def fold_biases(networks: Networks) -> Networks:
    """Return a copy in which every bias of a sine layer is from 0 to pi / (2 omega), but for float32 rounding."""
    out = networks.copy()
    for k in range(len(out)):
        tensors = out.tensors(k)
        for at in range(0, len(tensors) - 2, 2):
            matrix, bias, following = tensors[at : at + 3]
            turns = torch.round(bias.double() * networks.omegas[k] / math.pi)
            bias.copy_(bias.double() - turns * math.pi / networks.omegas[k])
            following *= 1 - 2 * (turns % 2).float()
            signs = 1 - 2 * (bias < 0).float()
            bias *= signs
            matrix *= signs[:, None]
            following *= signs
    return out


def sort_neurons(symbols: list[Symbols]) -> list[Symbols]:
    """Sort the neurons of every sine layer by bias, with no bias below 0. symbols: of one network, in file order."""
    out = [s.copy() for s in symbols]
    for at in range(0, len(out) - 2, 2):
        signs = np.where(out[at + 1] < 0, -1, 1).astype(np.int32)
        order = np.argsort(out[at + 1] * signs, kind="stable")
        out[at] = (out[at] * signs[:, None])[order]
        out[at + 1] = (out[at + 1] * signs)[order]
        out[at + 2] = (out[at + 2] * signs)[:, order]
    return out
