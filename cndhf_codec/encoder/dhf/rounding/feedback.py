"""Rounding the weights of a fitted model with error feedback, against the composite loss.

H, the Gauss-Newton matrix of the composite loss, says what a change of the weights costs. Weights are rounded one after
the other, and the error of each is compensated by those still to be rounded, as in GPTQ (Frantar et al., 2022); Babai's
nearest plane is the same rule.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.linalg.lapack import dtrtri

from ....arrays import F64, I64, Mask
from ....format.constants import MAX_SYMBOL, STEP_CODE_MASK, STEPS_PER_OCTAVE
from ...deadline import Deadline
from ...progress import OnStep
from ...settings import Settings
from ...thread_pool import Team
from ..fit.joint import tune
from ..fit.loss import Composite
from ..network.siren import Networks
from .gauss_newton import blocks

DAMPING = 0.01  # share of H's mean diagonal that is added to the diagonal
FIRST_ROUND = 0.5  # share of the free weights that each round but the last fixes
TOGETHER = 9000  # most weights of a network whose errors feed each other: their matrix must fit in memory
GROWTH = 2.0  # room for what feedback and training add to the largest weight of a tensor
COARSEST = 2.5  # octaves: at most so much coarser than those of another network are a network's steps
GAUSSIAN_BITS = 2.05  # entropy of a rounded Gaussian of standard deviation 1: 0.5 log2(2 pi e)

Codes = I64  # (K, tensors) step codes


def sensitivities(networks: Networks, composite: Composite, seed: int, team: Team) -> list[list[F64]]:
    """The Gauss-Newton matrices of all weights, as `round_networks` takes them: for every part of the weights that is
    rounded together, the matrix of each network."""
    return [blocks(networks, composite, seed, team, part) for part in _parts(networks)]


def relative_steps(networks: Networks, matrices: list[list[F64]]) -> F64:
    """(K, tensors) log2 of the step of every tensor of every network, up to a common level.

    Rounding weight i with step d costs in proportion to (d / U_ii)^2, where H^-1 = U^T U, when its error is fed to the
    weights after it. Equal costs spend the fewest bits: the step of a tensor is proportional to the geometric mean of
    its U_ii. No network's steps are more than COARSEST coarser, on average, than those of the finest.
    """
    logs = [
        np.concatenate([-np.log2(np.diag(_inverse_factor(part[k]))) for part in matrices if len(part[k])])
        for k in range(len(networks))
    ]
    levels = np.array([of_network.mean() for of_network in logs])
    # What hardly matters now would matter if it were rounded to something else altogether.
    excess = np.maximum(levels - levels.min() - COARSEST, 0)
    return _by_tensor(np.add, networks, logs) / _sizes(networks) - excess[:, None]


def step_codes(networks: Networks, logs: F64, bits: float) -> Codes:
    """Step code of every tensor, for about `bits` bits a weight; `logs` is what `relative_steps` gives."""
    theta, sizes = networks.weights(), _sizes(networks)
    rows = [row[:count] for row, count in zip(theta, networks.counts, strict=True)]
    spread = np.log2(np.maximum(np.sqrt(_by_tensor(np.add, networks, [row**2 for row in rows]) / sizes), 1e-9))
    # Bits of a tensor at step 2^(log + level), as for Gaussians; bisect the level.
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
    networks: Networks,
    composite: Composite,
    settings: Settings,
    codes: Codes,
    matrices: list[list[F64]],
    seed: int,
    team: Team,
    on_step: OnStep,
    deadline: Deadline,
) -> None:
    """Round all weights in place to multiples of their steps, in `settings.rounds` rounds.

    Each round fixes the costliest half of what is free (the last one all of it), and the free weights are trained on
    for `settings.round_steps` steps between rounds. matrices: what `sensitivities` gives for the
    networks as they come.
    """
    steps = weight_steps(networks, codes)
    held = np.zeros(steps.shape, dtype=bool)
    for r in range(settings.rounds):
        last = r == settings.rounds - 1
        theta = networks.weights()
        before = held.copy()
        for p, part in enumerate(_parts(networks)):
            of_free = matrices[p] if r == 0 else blocks(networks, composite, seed + r, team, ~before & part)
            for k, H in enumerate(of_free):
                free = np.flatnonzero(~before[k] & part[k])
                if not len(free):
                    continue
                step = steps[k, free]
                order = np.argsort(-np.diag(H) * step**2, kind="stable")
                count = len(free) if last else round(len(free) * FIRST_ROUND)
                theta[k, free] = _round_in_order(theta[k, free], H, step, order, count)
                held[k, free[order[:count]]] = True
        networks.theta.copy_(torch.from_numpy(theta))
        if not last:
            done = r * settings.round_steps

            def report(step: int, loss: float, done: int = done) -> None:
                on_step(done + step, loss)

            mask = torch.from_numpy(held).to(networks.theta.device)
            tune(
                networks,
                composite,
                settings.batch,
                settings.round_steps,
                settings.round_rate,
                seed + r,
                report,
                deadline.part(1 / (settings.rounds - 1 - r)),
                mask,
            )


def _parts(networks: Networks) -> Mask:
    """(parts, K, P) masks of the weights that are rounded together: whole tensors, and all of a network's when they are
    few."""
    counts = [math.ceil(n / TOGETHER) for n in networks.counts]
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
    """(K, tensors): how many weights each has."""
    return np.array([networks.sizes(k) for k in range(len(networks))])


def _by_tensor(sum_or_most: np.ufunc, networks: Networks, rows: list[F64]) -> F64:
    """(K, tensors): np.add or np.maximum over the tensors of what there is of every weight, a row a network."""
    return np.stack([sum_or_most.reduceat(row, networks.starts(k)) for k, row in enumerate(rows)])


def _inverse_factor(H: F64) -> F64:
    """Upper triangular M with H + damping = M M^T; U = M^-1 then has (H + damping)^-1 = U^T U."""
    damped = H + np.eye(len(H)) * (DAMPING * np.trace(H) / len(H) + 1e-30)
    # The Cholesky factor of the matrix with rows and columns reversed, reversed back.
    return np.asarray(np.linalg.cholesky(damped[::-1, ::-1])[::-1, ::-1])


def _round_in_order(theta: F64, H: F64, step: F64, order: I64, count: int) -> F64:
    """Round the first `count` weights of `order`; all later ones take up the errors."""
    U = dtrtri(_inverse_factor(H[np.ix_(order, order)]))[0]
    w, d = theta[order].copy(), step[order]
    for i in range(count):
        rounded = min(max(np.rint(w[i] / d[i]), -MAX_SYMBOL), MAX_SYMBOL) * d[i]
        w[i + 1 :] -= (w[i] - rounded) / U[i, i] * U[i, i + 1 :]
        w[i] = rounded
    out = np.empty_like(theta)
    out[order] = w
    return out
