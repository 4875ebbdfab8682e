"""The Gauss-Newton matrix of the joint loss.

The loss is a sum of absolute values. As in iteratively reweighted least squares, it is taken as a sum of squares: |r|
is locally r^2 / (2 |r|). The networks share no weight, and one of them answers for each sample, so the matrix has one
block per network.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from ....arrays import F32, F64, Mask
from ...thread_pool import ThreadPool
from ..fit.loss import JointLoss
from ..network import kernel
from ..network.siren import Networks

# Evidence for these constants: ADR 023.
HINGE_WIDTH = 0.003  # least |argument| with which a hinge counts
KEPT_WEIGHT = 0.03  # of a hinge that is kept: without any weight there, rounding would make floaters
JACOBIAN_ROWS = 2048  # computed at a time
BLOCK_COLUMNS = 512  # of the matrix, to which one thread adds at a time
SPACE_SHARE = 0.5  # samples of space drawn for the matrices, per sample of the surface


class Draw(NamedTuple):
    """How samples are drawn. per_weight: samples of the surface per weight of all networks."""

    seed: int
    per_weight: float


def gauss_newton_blocks(networks: Networks, loss: JointLoss, draw: Draw, threads: ThreadPool, free: Mask) -> list[F64]:
    """Make the matrix of every network from a fresh draw of samples. Its rows and columns are the weights that are
    `free`, a mask (K, P), in file order; without any, it is empty."""
    count = draw.per_weight * sum(networks.counts)
    rng = np.random.default_rng(draw.seed)
    surface, space = loss.active.draw(round(count), round(SPACE_SHARE * count), rng)
    with torch.no_grad():
        terms = loss.terms(networks, surface, space)
    n = len(surface)
    argument = terms.argument.abs().numpy().astype(np.float64)
    weight = terms.weight.numpy().astype(np.float64)
    # Near zero, r^2 / (2 |r|) would be too steep: |r| counts as at least the median.
    weight[:n] /= np.maximum(argument[:n], np.median(argument[:n])) * n
    kept = terms.argument[n:].numpy() <= 0
    weight[n:] *= np.where(kept, KEPT_WEIGHT, 1.0) / np.maximum(argument[n:], HINGE_WIDTH) / max(len(space), 1)
    field, side = terms.field.numpy(), terms.side.numpy()
    out = []
    for k in range(len(networks)):
        columns = np.flatnonzero(free[k])
        H = np.zeros((len(columns), len(columns)))
        out.append(H)
        if not len(columns):
            continue
        rows = np.flatnonzero((field == k) & (weight > 0))
        uv = terms.uv[k].numpy()
        for at in range(0, len(rows), JACOBIAN_ROWS):
            part = rows[at : at + JACOBIAN_ROWS]
            jacobian = kernel.jacobian(networks.net(k), uv[part], side[part])
            jacobian = jacobian[:, columns]
            jacobian *= np.sqrt(weight[part]).astype(np.float32)[:, None]
            _add_square(H, jacobian, threads)
        _mirror(H)
    return out


def _add_square(H: F64, jacobian: F32, threads: ThreadPool) -> None:
    """Add J^T J to the lower triangle of H. Every thread has columns of its own."""

    def add(at: int) -> None:
        H[at:, at : at + BLOCK_COLUMNS] += jacobian[:, at:].T @ jacobian[:, at : at + BLOCK_COLUMNS]

    threads.map(add, range(0, len(H), BLOCK_COLUMNS))


def _mirror(H: F64) -> None:
    """Copy the lower triangle of H to the upper, block by block."""
    for at in range(0, len(H), BLOCK_COLUMNS):
        block = H[at : at + BLOCK_COLUMNS, at : at + BLOCK_COLUMNS]
        block[:] = np.tril(block) + np.tril(block, -1).T
        H[at : at + BLOCK_COLUMNS, at + BLOCK_COLUMNS :] = H[at + BLOCK_COLUMNS :, at : at + BLOCK_COLUMNS].T
