"""Joint fine-tuning: all double height fields at once on the composite loss."""

from __future__ import annotations

import math

import torch

from ..errors import EncodeError
from .composite import Composite, Network
from .fit import soap
from .progress import OnStep
from .settings import Settings

WARM_UP = 50  # steps of rising learning rate
SURFACE = 0.5  # share of a batch drawn on the surface
LOOK_EVERY = 300  # steps between searches for violations
REPORT_EVERY = 20  # steps


def tune(
    networks: list[Network],
    composite: Composite,
    settings: Settings,
    steps: int,
    rate: float,
    seed: int,
    on_step: OnStep,
    held: list[Network] | None = None,
) -> None:
    """Train the networks in place for `steps` steps, learning rate `rate` falling to zero along a cosine.

    held: per tensor a boolean mask of the weights to leave as they are. Raises EncodeError when it diverges.
    """
    generator = torch.Generator().manual_seed(seed)
    optimisers = [soap(n, rate) for n in networks]
    masks = None if held is None else [m for masks in held for m in masks]
    tensors = [t for n in networks for t in n]
    fixed = None if masks is None else [t.detach()[m].clone() for t, m in zip(tensors, masks, strict=True)]
    n_surface = round(settings.batch * SURFACE)
    for step in range(1, steps + 1):
        scale = min(1.0, step / WARM_UP) * 0.5 * (1 + math.cos(math.pi * (step - 1) / steps))
        if (step - 1) % LOOK_EVERY == 0:
            composite.look_for_violations(networks)
        on, off = composite.draw(n_surface, settings.batch - n_surface, generator)
        cost = composite.terms(networks, on, off).cost
        loss = cost[:n_surface].mean() + cost[n_surface:].mean()
        for t in tensors:
            t.grad = None
        loss.backward()
        if masks is not None:
            for t, m in zip(tensors, masks, strict=True):
                if t.grad is not None:
                    t.grad[m] = 0
        for optimiser in optimisers:
            optimiser.param_groups[0]["lr"] = rate * scale
            optimiser.step()
        if masks is not None and fixed is not None:
            with torch.no_grad():
                for t, m, v in zip(tensors, masks, fixed, strict=True):
                    t[m] = v
        if step % REPORT_EVERY == 0 or step == steps:
            value = loss.item()
            if not math.isfinite(value):
                raise EncodeError(f"the joint fit diverged at step {step}; try another --seed")
            on_step(step, value)
