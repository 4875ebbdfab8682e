"""The Gauss-Newton matrix of the composite loss.

The loss is a sum of absolute values; iteratively reweighted least squares makes it one of squares: |r| is locally
r^2 / (2 |r|). The networks share no weight and every sample is answered for by one of them, so the matrix has one
block a network.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from .composite import Composite, Network
from .siren import Trace

HINGE_WIDTH = 0.003  # least |argument| that a hinge is taken at
IDLE = 0.03  # weight of a hinge that is kept: what no hinge holds would run away, and come back as a floater
ROWS = 2048  # of the Jacobian held at once
SHARDS = 4  # pieces that threads work on
SURFACE, SPACE = 40_000, 20_000  # samples that one matrix is built from

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]


def blocks(
    networks: list[Network], composite: Composite, surface: torch.Tensor, space: torch.Tensor, pool: Executor
) -> list[F64]:
    """Matrix (P, P) of every network, weights in file order, from the samples with these indices."""
    with torch.no_grad():
        terms = composite.terms(networks, surface, space)
    n = len(surface)
    argument = terms.argument.abs().cpu().numpy().astype(np.float64)
    weight = terms.weight.cpu().numpy().astype(np.float64)
    # Near zero the bend of |r| is spread over the median residual.
    weight[:n] /= np.maximum(argument[:n], np.median(argument[:n])) * n
    kept = terms.argument[n:].cpu().numpy() <= 0
    weight[n:] *= np.where(kept, IDLE, 1.0) / np.maximum(argument[n:], HINGE_WIDTH) / max(len(space), 1)
    dhf, side = terms.dhf.cpu().numpy(), terms.side.cpu().numpy()
    out = []
    for k, network in enumerate(networks):
        rows = np.flatnonzero((dhf == k) & (weight > 0))
        uv = terms.uv[k].cpu().numpy()
        tensors = [t.detach().cpu().numpy() for t in network]

        def shard(rows: Any, uv: F32 = uv, tensors: list[F32] = tensors) -> F64:
            parameters = sum(t.size for t in tensors)
            matrix = np.zeros((parameters, parameters))
            for at in range(0, len(rows), ROWS):
                part = rows[at : at + ROWS]
                jacobian = Trace(tensors, uv[part], composite.omega).jacobian(side[part])
                jacobian *= np.sqrt(weight[part]).astype(np.float32)[:, None]
                matrix += jacobian.T @ jacobian
            return matrix

        # As many shards on every machine, added in order: the number of threads changes nothing.
        out.append(np.sum(list(pool.map(shard, np.array_split(rows, SHARDS))), axis=0))
    return out


def flat(network: Network) -> F64:
    """All weights of a network, file order."""
    return np.concatenate([t.detach().cpu().numpy().ravel() for t in network]).astype(np.float64)


def fill(network: Network, theta: F64) -> None:
    """The reverse of `flat`, in place."""
    at = 0
    with torch.no_grad():
        for t in network:
            t.copy_(torch.from_numpy(theta[at : at + t.numel()].reshape(t.shape)))
            at += t.numel()
