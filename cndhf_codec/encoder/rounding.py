"""Rounding the weights of a fitted model with error feedback, against the composite loss.

H, the Gauss-Newton matrix of the composite loss, says what a change of the weights costs. Weights are rounded one after
the other, and the error of each is compensated by those still to be rounded, as in GPTQ (Frantar et al., 2022); Babai's
nearest plane is the same rule.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np
import numpy.typing as npt
import torch
from scipy.linalg.lapack import dtrtri

from ..format.constants import MAX_SYMBOL, STEP_CODE_MASK, STEPS_PER_OCTAVE
from .composite import Composite, Network
from .gauss_newton import SPACE, SURFACE, blocks, fill, flat
from .progress import OnStep
from .settings import Settings
from .tune import tune

DAMPING = 0.01  # share of H's mean diagonal that is added to the diagonal
FIRST_ROUND = 0.5  # share of the free weights that each round but the last fixes
GAUSSIAN_BITS = 2.05  # entropy of a rounded Gaussian of standard deviation 1: 0.5 log2(2 pi e)

F64 = npt.NDArray[np.float64]


def matrices(networks: list[Network], composite: Composite, seed: int, pool: Executor) -> list[F64]:
    """H of every network, (P, P), from a fresh draw of samples."""
    generator = torch.Generator().manual_seed(seed)
    surface, space = composite.draw(SURFACE, SPACE, generator)
    return blocks(networks, composite, surface, space, pool)


def relative_steps(networks: list[Network], matrices_of: list[F64]) -> F64:
    """log2 of the step of every tensor of every network, up to a common level.

    Rounding weight i with step d costs in proportion to (d / U_ii)^2, where H^-1 = U^T U, when its error is fed to the
    weights after it. Equal costs spend the fewest bits: the step of a tensor is proportional to the geometric mean of
    its U_ii.
    """
    logs = []
    for H, network in zip(matrices_of, networks, strict=True):
        log_u = -np.log2(np.diag(_inverse_factor(H)))
        parts = np.split(log_u, np.cumsum([t.numel() for t in network])[:-1])
        logs += [float(p.mean()) for p in parts]
    return np.array(logs)


def step_codes(networks: list[Network], flat_logs: F64, bits: float) -> list[list[int]]:
    """Step code of every tensor, for about `bits` bits a weight; `flat_logs` is what `relative_steps` gives."""
    tensors = [t.detach().cpu().numpy() for n in networks for t in n]
    sizes = np.array([t.size for t in tensors])
    # Bits of tensor t at step 2^(log + level), as for Gaussians; bisect the level.
    spread = np.array([np.log2(max(float(np.sqrt(np.mean(t * t))), 1e-9)) for t in tensors])
    low, high = -60.0, 60.0
    for _ in range(60):
        level = (low + high) / 2
        spent = (np.maximum(spread - flat_logs - level + GAUSSIAN_BITS, 0.2) * sizes).sum() / sizes.sum()
        low, high = (level, high) if spent > bits else (low, level)
    codes = []
    for t, log in zip(tensors, flat_logs, strict=True):
        # No finer than the symbols' range allows, with room for what feedback adds.
        finest = np.log2(max(float(np.abs(t).max()), 1e-9) * 1.25 / MAX_SYMBOL)
        code = int(np.floor(-max(log + level, finest) * STEPS_PER_OCTAVE + 0.5))
        codes.append(min(max(code, 0), STEP_CODE_MASK))
    out, at = [], 0
    for n in networks:
        out.append(codes[at : at + len(n)])
        at += len(n)
    return out


def round_networks(
    networks: list[Network],
    composite: Composite,
    settings: Settings,
    codes: list[list[int]],
    seed: int,
    pool: Executor,
    on_step: OnStep,
) -> None:
    """Round all weights in place to multiples of their steps, in `settings.rounds` rounds.

    Each round fixes the costliest half of what is free (the last one all of it), and the free weights are trained on
    for `settings.round_steps` steps between rounds.
    """
    steps = [_step_of_weights(n, c) for n, c in zip(networks, codes, strict=True)]
    held = [np.zeros(len(s), dtype=bool) for s in steps]
    for r in range(settings.rounds):
        last = r == settings.rounds - 1
        H_all = matrices(networks, composite, seed + r, pool)
        for network, H, step, mask in zip(networks, H_all, steps, held, strict=True):
            theta = flat(network)
            free = np.flatnonzero(~mask)
            block = H[np.ix_(free, free)]
            order = np.argsort(-np.diag(block) * step[free] ** 2, kind="stable")
            count = len(free) if last else round(len(free) * FIRST_ROUND)
            theta[free] = _round_in_order(theta[free], block, step[free], order, count)
            mask[free[order[:count]]] = True
            fill(network, theta)
        if not last:
            masks = [_shaped(n, m) for n, m in zip(networks, held, strict=True)]
            done = r * settings.round_steps

            def report(step: int, loss: float, done: int = done) -> None:
                on_step(done + step, loss)

            tune(networks, composite, settings, settings.round_steps, settings.round_rate, seed + r, report, masks)


def _inverse_factor(H: F64) -> F64:
    """Upper triangular M with H + damping = M M^T; U = M^-1 then has (H + damping)^-1 = U^T U."""
    damped = H + np.eye(len(H)) * (DAMPING * np.trace(H) / len(H) + 1e-30)
    # The Cholesky factor of the matrix with rows and columns reversed, reversed back.
    return np.asarray(np.linalg.cholesky(damped[::-1, ::-1])[::-1, ::-1])


def _round_in_order(theta: F64, H: F64, step: F64, order: npt.NDArray[np.int64], count: int) -> F64:
    """Round the first `count` weights of `order`; all later ones take up the errors."""
    U = dtrtri(_inverse_factor(H[np.ix_(order, order)]))[0]
    w, d = theta[order].copy(), step[order]
    for i in range(count):
        rounded = np.rint(w[i] / d[i]) * d[i]
        w[i + 1 :] -= (w[i] - rounded) / U[i, i] * U[i, i + 1 :]
        w[i] = rounded
    out = np.empty_like(theta)
    out[order] = w
    return out


def _shaped(network: Network, mask: npt.NDArray[np.bool_]) -> Network:
    parts = np.split(mask, np.cumsum([t.numel() for t in network])[:-1])
    return [torch.from_numpy(p.reshape(t.shape)).to(t.device) for p, t in zip(parts, network, strict=True)]


def _step_of_weights(network: Network, codes: list[int]) -> F64:
    return np.concatenate(
        [np.full(t.numel(), 2 ** (-c / STEPS_PER_OCTAVE)) for t, c in zip(network, codes, strict=True)]
    )
