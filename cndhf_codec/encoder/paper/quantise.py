"""Quantise a network: one step per tensor, chosen so that rounding raises the loss by no more than allowed."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import F32
from ...decoder.dhf.network import Network
from ...errors import EncodeError
from ...format.constants import MAX_SYMBOL, STEP_CODE_MASK, STEPS_PER_OCTAVE
from ...format.container import DhfRecord, Symbols, step_size
from ..dhf.fit.single import SILHOUETTE_SHARE
from ..dhf.fit.targets import HeightTargets
from .settings import PaperSettings

Tensors = list[F32]

PROBE_POINTS = 2**15
PROBE_STEP = 2.0**-10  # step that measures a tensor's sensitivity, relative to its RMS value


def quantise(tensors: Tensors, targets: HeightTargets, settings: PaperSettings, seed: int) -> DhfRecord:
    """Round a fitted network with the coarsest steps whose loss is within `settings.quantisation_loss` of the unrounded
    network's.

    The squares of the tensors' errors add up. So for a given total the fewest bits are spent when a tensor of n
    weights, whose rounding with step d moves the heights by s d, has d in proportion to sqrt(n) / s. Raises EncodeError
    when even the finest steps cost more than allowed.
    """
    probe = _Probe(targets, settings, seed)
    allowed = probe.loss(tensors) * (1 + settings.quantisation_loss)
    relative = _relative_steps(tensors, probe, seed)

    def attempt(level: int) -> tuple[list[int], list[Symbols], float]:
        codes = [_code(r * 2 ** (-level / STEPS_PER_OCTAVE), t) for r, t in zip(relative, tensors, strict=True)]
        symbols = [np.rint(t / step_size(c)).astype(np.int32) for t, c in zip(tensors, codes, strict=True)]
        rounded = [(s * step_size(c)).astype(np.float32) for s, c in zip(symbols, codes, strict=True)]
        return codes, symbols, probe.loss(rounded)

    # Except for noise, the loss falls as the level rises: bisect for the level where it passes the bound.
    low, high = 0, STEP_CODE_MASK
    codes, symbols, loss = attempt(high)
    if loss > allowed:
        raise EncodeError("rounding the weights costs more than allowed at any step; try another --seed")
    while high - low > 1:
        middle = (low + high) // 2
        tried = attempt(middle)
        if tried[2] <= allowed:
            high, (codes, symbols, _) = middle, tried
        else:
            low = middle
    return DhfRecord(
        quaternion=targets.frame.quaternion,
        box=targets.frame.box,
        width=len(tensors[0]),
        hidden_layers=settings.hidden_layers,
        omega_first=settings.omega,
        omega_hidden=settings.omega,
        step_codes=tuple(codes),
        symbols=tuple(symbols),
    )


class _Probe:
    """Fixed sample points at which a network's heights and its loss are computed."""

    def __init__(self, targets: HeightTargets, settings: PaperSettings, seed: int) -> None:
        rng = np.random.default_rng(seed)
        hit = targets.hit.ravel()
        inside, outside = np.flatnonzero(hit), np.flatnonzero(~hit)
        n_outside = round(PROBE_POINTS * (1 - SILHOUETTE_SHARE)) if len(outside) else 0
        at = rng.choice(inside, PROBE_POINTS - n_outside)
        if n_outside:
            at = np.concatenate([at, rng.choice(outside, n_outside)])
        self.n_inside = PROBE_POINTS - n_outside
        self.settings = settings
        self.uv = targets.uv.reshape(-1, 2)[at]
        at = at[: self.n_inside]
        self.truth = np.stack([targets.near.ravel()[at], targets.far.ravel()[at]], axis=1)
        self.known = np.stack([targets.near_known.ravel()[at], targets.far_known.ravel()[at]], axis=1)

    def heights(self, tensors: Tensors) -> F32:
        return Network(tensors, self.settings.omega, self.settings.omega)(self.uv)

    def loss(self, tensors: Tensors) -> float:
        """L1 and hinge of the fit at these points."""
        y, n = self.heights(tensors), self.n_inside
        loss = float((np.abs(y[:n] - self.truth) * self.known).sum()) / n
        if n < len(y):
            loss += float(np.maximum(y[n:, 1] - y[n:, 0] + self.settings.margin, 0).mean())
        return loss


def _relative_steps(tensors: Tensors, probe: _Probe, seed: int) -> list[float]:
    """Choose the tensors' steps relative to each other, the largest 1."""
    rng = np.random.default_rng(seed)
    before = probe.heights(tensors)
    steps = []
    for k, t in enumerate(tensors):
        step = PROBE_STEP * max(float(np.sqrt(np.mean(t * t))), 1e-6)
        noise = ((rng.random(t.shape) - 0.5) * step).astype(np.float32)
        moved = probe.heights([*tensors[:k], t + noise, *tensors[k + 1 :]])
        sensitivity = math.sqrt(float(np.mean((moved - before) ** 2))) / step
        steps.append(math.sqrt(t.size) / max(sensitivity, 1e-12))
    return [s / max(steps) for s in steps]


def _code(step: float, tensor: F32) -> int:
    """Choose the step code nearest to a step, no finer than the symbols' range allows."""
    finest = float(np.abs(tensor).max()) / MAX_SYMBOL
    code = round(-math.log2(max(step, 2.0**-40)) * STEPS_PER_OCTAVE)
    code = min(max(code, 0), STEP_CODE_MASK)
    while code > 0 and step_size(code) < finest:
        code -= 1
    return code
