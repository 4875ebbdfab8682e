"""The Gauss-Newton matrix of the composite loss, and a fit that uses it (Levenberg-Marquardt).

The loss is a sum of absolute values; iteratively reweighted least squares makes it one of squares: |r| is locally
r^2 / (2 |r|). The networks share no weight and every sample is answered for by one of them, so the matrix has one
block a network.
"""

from __future__ import annotations

import math
from concurrent.futures import Executor
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from .composite import Composite, Network
from .progress import OnStep
from .siren import Trace

HINGE_WIDTH = 0.003  # least |argument| that a hinge is taken at
IDLE = 0.2  # weight of a hinge that is kept: what no hinge holds would run away, and come back as a floater
ROWS = 2048  # of the Jacobian held at once
SURFACE, SPACE = 40_000, 20_000  # samples that one matrix is built from
TRIALS = 3  # dampings tried before an iteration is given up
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-6  # share of the diagonal

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]


def blocks(
    networks: list[Network], composite: Composite, surface: torch.Tensor, space: torch.Tensor, pool: Executor
) -> list[tuple[F64, F64]]:
    """Matrix (P, P) and gradient (P,) of every network, weights in file order, from the samples with these indices."""
    with torch.no_grad():
        terms = composite.terms(networks, surface, space)
    n = len(surface)
    argument = terms.argument.abs().cpu().numpy().astype(np.float64)
    weight = terms.weight.cpu().numpy().astype(np.float64)
    # Near zero the bend of |r| is spread over the median residual.
    weight[:n] /= np.maximum(argument[:n], np.median(argument[:n])) * n
    kept = terms.argument[n:].cpu().numpy() <= 0
    weight[n:] *= np.where(kept, IDLE, 1.0) / np.maximum(argument[n:], HINGE_WIDTH) / max(len(space), 1)
    dhf, side, error = (t.cpu().numpy() for t in (terms.dhf, terms.side, terms.error))
    out = []
    for k, network in enumerate(networks):
        rows = np.flatnonzero((dhf == k) & (weight > 0))
        uv = terms.uv[k].cpu().numpy()[rows]
        tensors = [t.detach().cpu().numpy() for t in network]
        parameters = sum(t.size for t in tensors)
        matrix, gradient = np.zeros((parameters, parameters)), np.zeros(parameters)

        def piece(at: int, uv: F32 = uv, rows: Any = rows, tensors: list[F32] = tensors) -> tuple[F32, F32]:
            part = rows[at : at + ROWS]
            jacobian = Trace(tensors, uv[at : at + ROWS], composite.omega).jacobian(side[part])
            pull = jacobian.T @ (weight[part] * error[part]).astype(np.float32)
            jacobian *= np.sqrt(weight[part]).astype(np.float32)[:, None]
            return jacobian.T @ jacobian, pull

        # Added in the order of the pieces, so that the number of threads changes nothing.
        for m, g in pool.map(piece, range(0, len(rows), ROWS)):
            matrix += m
            gradient += g
        out.append((matrix, gradient))
    return out


def polish(
    networks: list[Network],
    composite: Composite,
    iterations: int,
    seed: int,
    pool: Executor,
    on_step: OnStep,
    held: list[npt.NDArray[np.bool_]] | None = None,
) -> None:
    """Levenberg-Marquardt iterations in place, each on fresh samples. held: (P,) masks of weights to leave alone."""
    generator = torch.Generator().manual_seed(seed)
    damping = FIRST_DAMPING
    for i in range(1, iterations + 1):
        composite.look_for_violations(networks)
        surface, space = composite.draw(SURFACE, SPACE, generator)
        parts = blocks(networks, composite, surface, space, pool)
        before, start = _loss(networks, composite, surface, space), [flat(n) for n in networks]
        loss = math.inf
        for _ in range(TRIALS):
            for k, (network, (matrix, gradient)) in enumerate(zip(networks, parts, strict=True)):
                free = np.arange(len(gradient)) if held is None else np.flatnonzero(~held[k])
                H = matrix[np.ix_(free, free)]
                diagonal = np.diag(H)
                H = H + np.diag(damping * (diagonal + 1e-3 * diagonal.mean() + 1e-30))
                theta = start[k].copy()
                theta[free] -= np.linalg.solve(H, gradient[free])
                fill(network, theta)
            loss = _loss(networks, composite, surface, space)
            if loss < before:
                damping = max(damping / 3, LEAST_DAMPING)
                break
            damping *= 5
        else:
            for network, theta in zip(networks, start, strict=True):
                fill(network, theta)
        on_step(i, min(loss, before))


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


def _loss(networks: list[Network], composite: Composite, surface: torch.Tensor, space: torch.Tensor) -> float:
    with torch.no_grad():
        cost = composite.terms(networks, surface, space).cost
    n = len(surface)
    return float(cost[:n].mean() + cost[n:].mean())
