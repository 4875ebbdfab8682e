"""Joint fine-tuning: all double height fields at once on the composite loss."""

from __future__ import annotations

import math

import numpy as np
import torch

from ....errors import EncodeError
from ...deadline import Deadline
from ...progress import OnStep
from ..network.siren import Networks
from ..network.soap import Soap
from .loss import FAR, REACH, Composite
from .single import cosine_schedule

WARM_UP = 0.05  # of the steps the learning rate rises: sooner, and one network takes over what was another's
SURFACE = 0.7  # share of a batch drawn on the surface
LOOK_EVERY = 1000  # steps between looks at what matters to the loss
STEADY = 20  # widest networks that bear the whole learning rate; with wider ones the loss rises in the long run
EARLY = 700  # steps in which new networks change much, and everything is taken to matter
# A network that is asked less than others learns as much less a step, at least this share of it: its gradients are of
# few samples, and at full length its steps are a random walk, on which it loses what it has, or grows ever steeper.
LEAST_RATE = 0.2
AT_ONCE = 100  # steps that batches are drawn for, all between two looks; the loss is reported as often
TOGETHER = 20  # steps that are taken without a look at the deadline


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
    n_surface = round(batch * SURFACE)
    pulled = np.zeros(len(networks), np.bool_)
    for first in range(0, steps, TOGETHER):
        passed = deadline.passed()
        if passed >= 1:
            break
        if first == 0 or first % LOOK_EVERY == EARLY:
            composite.look(networks, FAR if first == 0 and held is None else REACH)
            shares = np.clip(composite.owned * len(networks), LEAST_RATE, 1.0)
        if first % AT_ONCE == 0:
            batches = composite.draw_batches(n_surface, batch - n_surface, min(AT_ONCE, steps - first), rng)
        last = min(first + TOGETHER, steps)
        done = [max(step / steps, passed) for step in range(first, last)]
        schedule = [rate * cosine_schedule((d + 1 / steps) / WARM_UP, d) for d in done]
        some = batches.part(first % AT_ONCE, first % AT_ONCE + len(done))
        loss, pulled_now = composite.descend(networks, optimiser, some, np.outer(schedule, shares), held)
        pulled |= pulled_now
        if last % AT_ONCE == 0 or last == steps:
            if not (math.isfinite(loss) and bool(torch.isfinite(networks.theta).all())):
                raise EncodeError(f"the joint fit diverged at step {last}; try another --seed")
            on_step(last, loss)
        if held is None and last % AT_ONCE == 0:
            if last > EARLY and len(networks) > 1 and not pulled.all():
                raise IdleNetworkError(int(pulled.argmin()))
            pulled[:] = False
