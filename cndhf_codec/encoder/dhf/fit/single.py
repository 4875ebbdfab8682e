"""The single fit: train one SIREN on one set of height targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Event, Lock

import numpy as np
import torch

from ....errors import EncodeError
from ...deadline import Deadline
from ...progress import OnStep
from ...thread_pool import ThreadPool
from ..network.siren import Networks, heights, initialise
from ..network.soap import Soap
from .targets import HeightTargets

# Fits one field: told when to stop, and whom to tell of steps done and of the loss.
Fit = Callable[[Event, OnStep], Networks]

# Evidence for these constants: ADR 010.
WARM_UP_STEPS = 100  # of rising learning rate
SILHOUETTE_SHARE = 0.75  # of a batch is drawn inside the silhouette
REPORT_EVERY = 20  # steps


@dataclass(frozen=True)
class Training:
    """How one network is fitted. batch: points per step. margin: C; outside the silhouette the far height is to be this
    much below the near one."""

    width: int
    hidden_layers: int
    omega: int
    steps: int
    learning_rate: float
    batch: int
    margin: float


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread: on tensors as small as these, more cost time, and they change the sums."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit_each(fits: Sequence[Fit], pool: ThreadPool, on_step: OnStep) -> list[Networks]:
    """Run every fit, several at a time. on_step: told the steps of all fits and their mean loss.

    Each fit runs in one thread, so that the result does not depend on how many there are. Raises EncodeError when a fit
    diverges.
    """
    stop, lock = Event(), Lock()
    done = [0] * len(fits)
    losses = [math.nan] * len(fits)

    def one(i: int) -> Networks:
        def report(step: int, loss: float) -> None:
            with lock:
                done[i], losses[i] = step, loss
                on_step(sum(done), float(np.nanmean(losses)))

        try:
            return fits[i](stop, report)
        except BaseException:
            # Interrupted or failed: stop the other fits, too.
            stop.set()
            raise

    return pool.map(one, range(len(fits)))


def fit_single(
    targets: HeightTargets, training: Training, seed: int, deadline: Deadline, stop: Event, report: OnStep
) -> Networks:
    """Fit one field on random points of its images with SOAP; for fewer steps where the deadline comes first."""
    generator = torch.Generator().manual_seed(seed)
    network = initialise(training.width, training.hidden_layers, training.omega, generator)
    theta = network.theta.requires_grad_()
    network = replace(network, theta=theta)
    loss_of, optimiser = PointLoss(targets, training.batch, training.margin), Soap(network)
    for step in range(1, training.steps + 1):
        done = max((step - 1) / training.steps, deadline.passed())
        if stop.is_set() or done >= 1:
            break
        loss = loss_of(network, generator)
        (gradient,) = torch.autograd.grad(loss, theta)
        with torch.no_grad():
            optimiser.step(gradient, training.learning_rate * cosine_schedule(step / WARM_UP_STEPS, done))
        if step % REPORT_EVERY == 0 or step == training.steps:
            value = loss.item()
            check_finite(value, step)
            report(step, value)
    return replace(network, theta=theta.detach())


def check_finite(loss: float, step: int) -> None:
    """Raise EncodeError for a fit that has diverged."""
    if not math.isfinite(loss):
        raise EncodeError(f"the fit diverged at step {step}; try another --seed")


def cosine_schedule(warm: float, done: float) -> float:
    """Share of the learning rate when the share `done` of the work is done. It rises while `warm` goes to 1, and falls
    to 0 along a cosine."""
    return min(1.0, warm) * 0.5 * (1 + math.cos(math.pi * done))


class PointLoss:
    """L1 on the known heights of points inside the silhouette; a hinge at points outside it."""

    def __init__(self, t: HeightTargets, batch: int, margin: float) -> None:
        """margin: C; outside the silhouette the far height is to be this much below the near one."""

        def put(array: np.ndarray, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(dtype)

        self._uv = put(t.uv.reshape(-1, 2))
        self._heights = put(np.stack([t.near.ravel(), t.far.ravel()], axis=1))
        self._known = put(np.stack([t.near_known.ravel(), t.far_known.ravel()], axis=1))
        self._inside = put(np.flatnonzero(t.hit), torch.int64)
        self._outside = put(np.flatnonzero(~t.hit), torch.int64)
        self._margin = margin
        self._n_outside = round(batch * (1 - SILHOUETTE_SHARE)) if len(self._outside) else 0
        self._n_inside = batch - self._n_outside

    def __call__(self, network: Networks, generator: torch.Generator) -> torch.Tensor:
        n = self._n_inside
        inside = self._inside[torch.randint(len(self._inside), (n,), generator=generator)]
        at = inside
        if self._n_outside:
            drawn = torch.randint(len(self._outside), (self._n_outside,), generator=generator)
            at = torch.cat([inside, self._outside[drawn]])
        y = heights(network, 0, self._uv[at])
        loss = ((y[:n] - self._heights[inside]).abs() * self._known[inside]).sum() / n
        if self._n_outside:
            loss = loss + torch.relu(y[n:, 1] - y[n:, 0] + self._margin).mean()
        return loss
