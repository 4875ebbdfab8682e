"""Joint fine-tuning: all double height fields at once on the composite loss."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..errors import EncodeError
from .composite import FAR, REACH, Composite
from .deadline import Deadline
from .fit import cosine_schedule
from .progress import OnStep
from .siren import Networks
from .soap import Soap

WARM_UP = 0.05  # of the steps the learning rate rises: sooner, and one network takes over what was another's
SURFACE = 0.7  # share of a batch drawn on the surface
LOOK_EVERY = 1000  # steps between looks at what matters to the loss
STEADY = 20  # widest networks that bear the whole learning rate; with wider ones the loss rises in the long run
EARLY = 700  # steps in which new networks change much, and everything is taken to matter
# A network that is asked less than others learns as much less a step, at least this share of it: its gradients are of
# few samples, and at full length its steps are a random walk, on which it loses what it has, or grows ever steeper.
LEAST_RATE = 0.2
AT_ONCE = 100  # steps that batches are drawn for, all between two looks; the loss is reported as often


class IdleNetworkError(Exception):
    """A network answers for no sample: the others do without it."""

    def __init__(self, number: int) -> None:
        self.number = number


def tune(
    networks: Networks,
    composite: Composite,
    batch: int,
    steps: int,
    rate: float,
    seed: int,
    on_step: OnStep,
    deadline: Deadline,
    held: torch.Tensor | None = None,
) -> None:
    """Train the networks in place for `steps` steps, learning rate `rate` falling to zero along a cosine; faster, and
    for fewer steps, when the deadline comes first. A network that owns less of the surface than an equal share takes as
    much less of the rate, at least LEAST_RATE of it. Where a network is wider than STEADY all take less, by the square
    of the width: a narrow one that is seldom asked, at a higher rate than the others, grows wild in the long run.

    held: (K, P) mask of the weights to leave as they are. Raises EncodeError when it diverges, and, with no weight
    held, IdleNetworkError when no sample of AT_ONCE steps has pulled at one of several networks.
    """
    rate *= min(1.0, (STEADY / max(networks.widths)) ** 2)
    rng = np.random.default_rng(seed)
    optimiser = Soap(networks)
    start = networks.theta.clone()
    n_surface = round(batch * SURFACE)
    pulled = torch.zeros(len(networks), dtype=torch.bool, device=networks.theta.device)
    for step in range(1, steps + 1):
        done = max((step - 1) / steps, deadline.passed())
        if done >= 1:
            break
        if step == 1 or step % LOOK_EVERY == EARLY + 1:
            composite.look(networks, FAR if step == 1 and held is None else REACH)
            rates = np.clip(composite.owned * len(networks), LEAST_RATE, 1.0) * rate
        if (step - 1) % AT_ONCE == 0:
            batches = iter(composite.draw_batches(n_surface, batch - n_surface, min(AT_ONCE, steps - step + 1), rng))
        gradient, loss = composite.gradient(networks, next(batches))
        if held is None:
            pulled |= gradient.any(dim=1)
        else:
            gradient.masked_fill_(held, 0)
        optimiser.step(gradient, rates * cosine_schedule((done + 1 / steps) / WARM_UP, done))
        if held is not None:
            torch.where(held, start, networks.theta, out=networks.theta)
        if step % AT_ONCE == 0 or step == steps:
            if not (math.isfinite(loss) and bool(torch.isfinite(networks.theta).all())):
                raise EncodeError(f"the joint fit diverged at step {step}; try another --seed")
            on_step(step, loss)
        if held is None and step % AT_ONCE == 0:
            if step > EARLY and len(networks) > 1 and not pulled.all():
                raise IdleNetworkError(int(pulled.long().argmin()))
            pulled.zero_()
