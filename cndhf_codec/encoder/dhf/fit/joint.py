"""The joint fit: train all double height fields at once on the joint loss."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from ....errors import EncodeError
from ...deadline import Deadline
from ...progress import OnStep
from ..network.siren import Networks
from ..network.soap import Soap
from .active_set import TOLERANCE
from .loss import JointLoss
from .sample_store import NO_FIELD
from .single import cosine_schedule

# Evidence for these constants: ADR 013; SURFACE_SHARE: 015; FIRST_REFRESH, DRAW_EVERY: 014; REFRESH_EVERY: 017;
# FULL_RATE_WIDTH: 012; CALL_STEPS: 021.
WARM_UP_SHARE = 0.05  # of the steps, in which the rate rises; faster, and one network takes over another's part
SURFACE_SHARE = 0.7  # of a batch is drawn on the surface
FIRST_REFRESH = 700  # steps until then, in which new networks change much and all fields are active
REFRESH_EVERY = 1000  # steps after that
FULL_RATE_WIDTH = 20  # widest networks that bear the whole rate; with wider ones the loss rises in the long run
# A network that answers for less than others gets less of the learning rate, but at least this share. Its gradients are
# of few samples: at the whole rate its steps are a random walk, on which it forgets, or grows ever steeper.
LEAST_RATE_SHARE = 0.2
DRAW_EVERY = 100  # steps for which batches are drawn; none spans a refresh. The loss is reported as often
CALL_STEPS = 20  # taken between two checks of the deadline


class IdleNetworkError(Exception):
    """A network answers for no sample: the others do without it. number: of the network."""

    def __init__(self, number: int) -> None:
        self.number = number


class Schedule(NamedTuple):
    """How long and how fast to train. batch: samples per step. rate: the highest learning rate, which falls to zero
    along a cosine."""

    batch: int
    steps: int
    rate: float


def joint_fit(
    networks: Networks,
    loss: JointLoss,
    schedule: Schedule,
    seed: int,
    on_step: OnStep,
    deadline: Deadline,
    held: torch.Tensor | None = None,
) -> None:
    """Train the networks in place. Where the deadline comes first, there are fewer steps, and the rate falls faster.

    A network that owns less of the surface than an equal share gets as much less of the rate, but at least
    LEAST_RATE_SHARE of it. Where one network is wider than FULL_RATE_WIDTH, all get less, by the square of the width: a
    narrow one that answers for little, at a higher rate than the others, would diverge in the long run.

    held: (K, P) mask of the weights to leave as they are. Raises EncodeError when the fit diverges, and, unless `held`
    is given, IdleNetworkError when one of several networks has had no gradient in DRAW_EVERY steps.
    """
    steps = schedule.steps
    highest = schedule.rate * min(1.0, (FULL_RATE_WIDTH / max(networks.widths)) ** 2)
    rng = np.random.default_rng(seed)
    optimiser = Soap(networks)
    n_surface = round(schedule.batch * SURFACE_SHARE)
    pulled = np.zeros(len(networks), np.bool_)
    for first in range(0, steps, CALL_STEPS):
        passed = deadline.passed()
        if passed >= 1:
            break
        if first == 0 or first % REFRESH_EVERY == FIRST_REFRESH:
            loss.active.refresh(networks, NO_FIELD if first == 0 and held is None else TOLERANCE)
            shares = np.clip(loss.active.owned * len(networks), LEAST_RATE_SHARE, 1.0)
        if first % DRAW_EVERY == 0:
            count = min(DRAW_EVERY, steps - first)
            batches = loss.active.draw_steps(n_surface, schedule.batch - n_surface, count, rng)
        last = min(first + CALL_STEPS, steps)
        done = [max(step / steps, passed) for step in range(first, last)]
        rates = [highest * cosine_schedule((d + 1 / steps) / WARM_UP_SHARE, d) for d in done]
        some = batches.part(first % DRAW_EVERY, first % DRAW_EVERY + len(done))
        cost, pulled_now = loss.descend(networks, optimiser, some, np.outer(rates, shares), held)
        pulled |= pulled_now
        if last % DRAW_EVERY == 0 or last == steps:
            if not (math.isfinite(cost) and bool(torch.isfinite(networks.theta).all())):
                raise EncodeError(f"the joint fit diverged at step {last}; try another --seed")
            on_step(last, cost)
        if held is None and last % DRAW_EVERY == 0:
            if last > FIRST_REFRESH and len(networks) > 1 and not pulled.all():
                raise IdleNetworkError(int(pulled.argmin()))
            pulled[:] = False
