"""The paper's fit of one field: Adam on L1, hinge and Laplacians, on random tiles of the height images."""

from __future__ import annotations

import math
from threading import Event

import numpy as np
import torch

from ...arrays import F32, Mask
from ...errors import EncodeError
from ..deadline import Deadline
from ..dhf.fit.single import WARM_UP_STEPS, check_finite, cosine_schedule
from ..dhf.fit.targets import HeightTargets
from ..dhf.network.siren import Networks, initialise
from ..progress import OnStep
from .settings import PaperSettings
from .steps import TILE_SIDE, Moments, TileImages, Weights, adam_steps

CALL_STEPS = 100  # that are taken without a look at the deadline
# The learning rate is that of this width, and falls as others are wider: a neuron's sum changes with the number of its
# inputs when Adam moves each weight as far (Yang et al., "Tensor Programs V", 2021). At 1e-3 a width of 92 collapses.
RATE_WIDTH = 30
# A loss so many times the least before it is that of a fit that has collapsed: its field is no longer the shape's.
COLLAPSE = 2


def fit_paper(
    targets: HeightTargets, settings: PaperSettings, seed: int, deadline: Deadline, stop: Event, report: OnStep
) -> Networks:
    """Fit one field; for fewer steps where the deadline comes first. Raises EncodeError when the fit diverges."""
    network = initialise(settings.width, settings.hidden_layers, settings.omega, torch.Generator().manual_seed(seed))
    net = network.net(0)
    moments = Moments(np.zeros_like(net.theta), np.zeros_like(net.theta))
    images, weights = tile_images(targets), weights_of(settings)
    last = np.array(targets.hit.shape) - TILE_SIDE + 1
    tiles_per_step = max(1, settings.batch // TILE_SIDE**2)
    rate = settings.learning_rate * RATE_WIDTH / settings.width
    rng = np.random.default_rng(seed)
    loss = least = math.inf
    for first in range(0, settings.steps, CALL_STEPS):
        passed = deadline.passed()
        if stop.is_set() or passed >= 1:
            break
        steps = range(first, min(first + CALL_STEPS, settings.steps))
        done = [max(step / settings.steps, passed) for step in steps]
        rates = [rate * cosine_schedule((step + 1) / WARM_UP_STEPS, d) for step, d in zip(steps, done, strict=True)]
        tiles = rng.integers(last, size=(len(steps), tiles_per_step, 2))
        loss = adam_steps(net, moments, first, images, tiles, np.array(rates), weights)
        check_finite(loss, steps[-1] + 1)
        report(steps[-1] + 1, loss)
        least = min(least, loss)
    if loss > COLLAPSE * least:
        raise EncodeError(
            f"the fit diverged: its loss has risen from {least:.2g} to {loss:.2g}; "
            "try another --seed or a smaller --width"
        )
    return network


def tile_images(t: HeightTargets) -> TileImages:
    """The targets as the compiled loss takes them, with their Laplacians: five-point sums h(left) + h(right) + h(below)
    + h(above) - 4 h, where all five heights are known."""
    known = _with_neighbours(t.near_known & t.far_known)
    laplacians = [np.where(known, _laplacian(h), 0) for h in (t.near, t.far)]
    return TileImages(
        t.uv,
        np.stack([t.near, t.far], axis=-1),
        np.stack([t.near_known, t.far_known], axis=-1).astype(np.float32),
        t.hit.astype(np.float32),
        np.stack(laplacians, axis=-1).astype(np.float32),
        known.astype(np.float32),
    )


def weights_of(settings: PaperSettings) -> Weights:
    return Weights(np.float32(settings.margin), np.float32(settings.laplacian))


def _laplacian(h: F32) -> F32:
    p = np.pad(h, 1)
    return np.asarray(p[2:, 1:-1] + p[:-2, 1:-1] + p[1:-1, 2:] + p[1:-1, :-2] - 4 * h)


def _with_neighbours(mask: Mask) -> Mask:
    p = np.pad(mask, 1)
    return np.asarray(mask & p[2:, 1:-1] & p[:-2, 1:-1] & p[1:-1, 2:] & p[1:-1, :-2])
