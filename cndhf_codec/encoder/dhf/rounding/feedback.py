"""Round the weights of fitted networks with error feedback, so that the joint loss rises least.

H, the Gauss-Newton matrix of the joint loss, says what a change of the weights costs. Weights are rounded one after the
other, and the weights still to be rounded compensate each error, as in GPTQ (Frantar et al., 2022). Babai's nearest
plane is the same rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg.lapack import dtrtri

from ....arrays import F64, I64, Mask
from ....format.constants import MAX_SYMBOL, STEP_CODE_MASK, STEPS_PER_OCTAVE
from ...deadline import Deadline
from ...progress import OnStep
from ...thread_pool import ThreadPool
from ..fit.joint import Schedule, joint_fit
from ..fit.loss import JointLoss
from ..network.siren import Networks
from ..settings import DhfSettings
from .gauss_newton import Draw, gauss_newton_blocks

# Evidence for these constants: ADR 023; GROWTH, GAUSSIAN_BITS: 024; COARSEST_OCTAVES: 014.
DAMPING = 0.01  # share of H's mean diagonal that is added to the diagonal
ROUND_SHARE = 0.5  # of the free weights that each round fixes; the last fixes all
MOST_TOGETHER = 9000  # weights of a network that compensate each other: their matrix must fit in memory
GROWTH = 2.0  # times that feedback and training may raise the largest weight of a tensor
COARSEST_OCTAVES = 2.5  # most by which a network's steps are coarser than those of the finest
GAUSSIAN_BITS = 2.05  # entropy of a rounded Gaussian of standard deviation 1: 0.5 log2(2 pi e)

Codes = I64  # (K, tensors) step codes


@dataclass(frozen=True, eq=False)
class Rounding:
    """How networks are rounded. codes: (K, tensors) step codes. matrices: the result of `gauss_newton_matrices` for the
    networks before rounding."""

    settings: DhfSettings
    codes: Codes
    matrices: list[list[F64]]
    seed: int


def gauss_newton_matrices(networks: Networks, loss: JointLoss, draw: Draw, threads: ThreadPool) -> list[list[F64]]:
    """Make the Gauss-Newton matrix of each network, for every group of weights that are rounded together."""
    return [gauss_newton_blocks(networks, loss, draw, threads, part) for part in _parts(networks)]


def relative_steps(networks: Networks, matrices: list[list[F64]]) -> F64:
    """Choose log2 of the step of every tensor, (K, tensors), up to a common level.

    When the later weights compensate its error, rounding weight i with step d costs in proportion to (d / U_ii)^2,
    where H^-1 = U^T U. Equal costs spend the fewest bits, so a tensor's step is in proportion to the geometric mean of
    its U_ii. No network's steps are more than COARSEST_OCTAVES coarser, on average, than those of the finest.
    """
    logs = [
        np.concatenate([-np.log2(np.diag(_inverse_factor(part[k]))) for part in matrices if len(part[k])])
        for k in range(len(networks))
    ]
    levels = np.array([of_network.mean() for of_network in logs])
    # A network that hardly matters now would matter if coarse steps changed it altogether.
    excess = np.maximum(levels - levels.min() - COARSEST_OCTAVES, 0)
    return _by_tensor(np.add, networks, logs) / _sizes(networks) - excess[:, None]


def step_codes(networks: Networks, logs: F64, bits: float) -> Codes:
    """Choose step codes for about `bits` bits per weight. logs: the result of `relative_steps`."""
    theta, sizes = networks.weights(), _sizes(networks)
    rows = [row[:count] for row, count in zip(theta, networks.counts, strict=True)]
    spread = np.log2(np.maximum(np.sqrt(_by_tensor(np.add, networks, [row**2 for row in rows]) / sizes), 1e-9))
    # A tensor at step 2^(log + level) takes about the bits of a Gaussian. Bisect the level.
    low, high = -60.0, 60.0
    for _ in range(60):
        level = (low + high) / 2
        spent = (np.maximum(spread - logs - level + GAUSSIAN_BITS, 0.2) * sizes).sum() / sizes.sum()
        low, high = (level, high) if spent > bits else (low, level)
    # No finer than the symbols' range allows.
    largest = _by_tensor(np.maximum, networks, [np.abs(row) for row in rows])
    finest = np.log2(np.maximum(largest, 1e-9) * GROWTH / MAX_SYMBOL)
    codes = np.floor(-np.maximum(logs + level, finest) * STEPS_PER_OCTAVE + 0.5)
    return np.clip(codes, 0, STEP_CODE_MASK).astype(np.int64)


def round_networks(
    networks: Networks, loss: JointLoss, rounding: Rounding, threads: ThreadPool, on_step: OnStep, deadline: Deadline
) -> None:
    """Round all weights in place to multiples of their steps, in `settings.rounds` rounds.

    Each round fixes the costliest half of the free weights, and the last round all of them. Between rounds the free
    weights are trained on for `settings.round_steps` steps.
    """
    settings, seed = rounding.settings, rounding.seed
    steps = weight_steps(networks, rounding.codes)
    held = np.zeros(steps.shape, dtype=bool)
    for r in range(settings.rounds):
        last = r == settings.rounds - 1
        theta = networks.weights()
        before = held.copy()
        for p, part in enumerate(_parts(networks)):
            matrices = rounding.matrices[p]
            if r > 0:
                draw = Draw(seed + r, settings.samples_per_weight)
                matrices = gauss_newton_blocks(networks, loss, draw, threads, ~before & part)
            for k, H in enumerate(matrices):
                free = np.flatnonzero(~before[k] & part[k])
                if not len(free):
                    continue
                step = steps[k, free]
                order = np.argsort(-np.diag(H) * step**2, kind="stable")
                count = len(free) if last else round(len(free) * ROUND_SHARE)
                theta[k, free] = _round_in_order(theta[k, free], H, step, order, count)
                held[k, free[order[:count]]] = True
        networks.theta.copy_(torch.from_numpy(theta))
        if not last:
            done = r * settings.round_steps

            def report(step: int, cost: float, done: int = done) -> None:
                on_step(done + step, cost)

            schedule = Schedule(settings.batch, settings.round_steps, settings.round_rate)
            time_left = deadline.part(1 / (settings.rounds - 1 - r))
            joint_fit(networks, loss, schedule, seed + r, report, time_left, torch.from_numpy(held))


def _parts(networks: Networks) -> Mask:
    """(groups, K, P) masks of the weights that are rounded together: whole tensors, and whole networks where these are
    small."""
    counts = [math.ceil(n / MOST_TOGETHER) for n in networks.counts]
    masks = np.zeros((max(counts), *networks.theta.shape), dtype=bool)
    for k, (sizes, count) in enumerate(zip(_sizes(networks), counts, strict=True)):
        of_tensor = np.minimum((np.cumsum(sizes) - sizes / 2) * count // sizes.sum(), count - 1)
        masks[:count, k, : sizes.sum()] = np.repeat(of_tensor, sizes) == np.arange(count)[:, None]
    return masks


def weight_steps(networks: Networks, codes: Codes) -> F64:
    """(K, P): the step of every weight."""
    steps = np.ones(networks.theta.shape)
    for k, count in enumerate(networks.counts):
        steps[k, :count] = np.repeat(2.0 ** (-codes[k] / STEPS_PER_OCTAVE), networks.sizes(k))
    return steps


def _sizes(networks: Networks) -> I64:
    """(K, tensors): number of weights of each tensor."""
    return np.array([networks.sizes(k) for k in range(len(networks))])


def _by_tensor(sum_or_most: np.ufunc, networks: Networks, rows: list[F64]) -> F64:
    """(K, tensors): np.add or np.maximum over each tensor, of rows with one number per weight."""
    return np.stack([sum_or_most.reduceat(row, networks.starts(k)) for k, row in enumerate(rows)])


def _inverse_factor(H: F64) -> F64:
    """Upper triangular M with H + damping = M M^T; U = M^-1 then has (H + damping)^-1 = U^T U."""
    damped = H + np.eye(len(H)) * (DAMPING * np.trace(H) / len(H) + 1e-30)
    # The Cholesky factor of the matrix with rows and columns reversed, reversed back.
    return np.asarray(np.linalg.cholesky(damped[::-1, ::-1])[::-1, ::-1])


def _round_in_order(theta: F64, H: F64, step: F64, order: I64, count: int) -> F64:
    """Round the first `count` weights of `order`; all later weights compensate the errors."""
    U = dtrtri(_inverse_factor(H[np.ix_(order, order)]))[0]
    w, d = theta[order].copy(), step[order]
    for i in range(count):
        rounded = min(max(np.rint(w[i] / d[i]), -MAX_SYMBOL), MAX_SYMBOL) * d[i]
        w[i + 1 :] -= (w[i] - rounded) / U[i, i] * U[i, i + 1 :]
        w[i] = rounded
    out = np.empty_like(theta)
    out[order] = w
    return out
