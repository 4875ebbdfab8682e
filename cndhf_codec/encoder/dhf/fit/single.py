"""The single fit: train one SIREN on one set of height targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Event, Lock

import numpy as np
import torch

from ....errors import EncodeError
from ...deadline import Deadline
from ...thread_pool import ThreadPool
from ..network.siren import Networks, heights, initialise
from ..network.soap import Soap
from .targets import HeightTargets

OnSteps = Callable[[int, int, float], None]  # done, total, loss
Loss = Callable[[Networks, torch.Generator], torch.Tensor]
Step = Callable[[torch.Tensor, float], None]  # gradient, learning rate

# Evidence for these constants: ADR 010.
WARM_UP_STEPS = 100  # of rising learning rate
SILHOUETTE_SHARE = 0.75  # of a batch is drawn inside the silhouette
REPORT_EVERY = 20  # steps


@dataclass(frozen=True)
class Training:
    """How one network is fitted. batch: points per step. loss: makes the loss from targets and the number of points per
    step. optimiser: makes the function that takes a step."""

    width: int
    hidden_layers: int
    omega: int
    steps: int
    learning_rate: float
    batch: int
    loss: Callable[[HeightTargets, int], Loss]
    optimiser: Callable[[Networks], Step]


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread: on tensors as small as these, more cost time, and they change the sums."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit_each(
    targets: list[HeightTargets],
    trainings: list[Training],
    seed: int,
    pool: ThreadPool,
    on_steps: OnSteps,
    deadline: Deadline,
) -> list[Networks]:
    """Fit every field alone, several at a time; for fewer steps where the deadline comes first.

    Each fit runs in one thread, so that the result does not depend on how many there are. Raises EncodeError when a fit
    diverges.
    """
    stop, lock = Event(), Lock()
    done = [0] * len(targets)
    losses = [math.nan] * len(targets)

    def one(i: int) -> Networks:
        def report(step: int, loss: float) -> None:
            with lock:
                done[i], losses[i] = step, loss
                on_steps(sum(done), sum(t.steps for t in trainings), float(np.nanmean(losses)))

        try:
            return fit_single(targets[i], trainings[i], seed + i, stop, report, deadline)
        except BaseException:
            # Interrupted or failed: stop the other fits, too.
            stop.set()
            raise

    return pool.map(one, range(len(targets)))


def fit_single(
    targets: HeightTargets,
    training: Training,
    seed: int,
    stop: Event,
    report: Callable[[int, float], None],
    deadline: Deadline,
) -> Networks:
    generator = torch.Generator().manual_seed(seed)
    network = initialise(training.width, training.hidden_layers, training.omega, generator)
    theta = network.theta.requires_grad_()
    network = replace(network, theta=theta)
    loss_of, step_by = training.loss(targets, training.batch), training.optimiser(network)
    for step in range(1, training.steps + 1):
        done = max((step - 1) / training.steps, deadline.passed())
        if stop.is_set() or done >= 1:
            break
        loss = loss_of(network, generator)
        (gradient,) = torch.autograd.grad(loss, theta)
        with torch.no_grad():
            step_by(gradient, training.learning_rate * cosine_schedule(step / WARM_UP_STEPS, done))
        if step % REPORT_EVERY == 0 or step == training.steps:
            value = loss.item()
            if not math.isfinite(value):
                raise EncodeError(f"the fit diverged at step {step}; try another --seed")
            report(step, value)
    return replace(network, theta=theta.detach())


def cosine_schedule(warm: float, done: float) -> float:
    """Share of the learning rate when the share `done` of the work is done. It rises while `warm` goes to 1, and falls
    to 0 along a cosine."""
    return min(1.0, warm) * 0.5 * (1 + math.cos(math.pi * done))


def soap(network: Networks) -> Step:
    return Soap(network).step


class Images:
    """A field's targets as tensors, pixels flattened."""

    def __init__(self, t: HeightTargets) -> None:
        def put(array: np.ndarray, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(dtype)

        self.shape = t.hit.shape
        self.uv = put(t.uv.reshape(-1, 2))
        self.heights = put(np.stack([t.near.ravel(), t.far.ravel()], axis=1))
        self.known = put(np.stack([t.near_known.ravel(), t.far_known.ravel()], axis=1))
        self.hit = put(t.hit.ravel())
        self.inside = put(np.flatnonzero(t.hit), torch.int64)
        self.outside = put(np.flatnonzero(~t.hit), torch.int64)


def draw(n: int, count: int, generator: torch.Generator) -> torch.Tensor:
    """Draw `count` integers below n."""
    return torch.randint(n, (count,), generator=generator)


class PointLoss:
    """L1 on the known heights of points inside the silhouette; a hinge at points outside it."""

    def __init__(self, t: HeightTargets, batch: int, margin: float) -> None:
        """margin: C; outside the silhouette the far height is to be this much below the near one."""
        self._images, self._margin = Images(t), margin
        self._n_outside = round(batch * (1 - SILHOUETTE_SHARE)) if len(self._images.outside) else 0
        self._n_inside = batch - self._n_outside

    def __call__(self, network: Networks, generator: torch.Generator) -> torch.Tensor:
        im, n = self._images, self._n_inside
        inside = im.inside[draw(len(im.inside), n, generator)]
        at = inside
        if self._n_outside:
            at = torch.cat([inside, im.outside[draw(len(im.outside), self._n_outside, generator)]])
        y = heights(network, 0, im.uv[at])
        loss = ((y[:n] - im.heights[inside]).abs() * im.known[inside]).sum() / n
        if self._n_outside:
            loss = loss + torch.relu(y[n:, 1] - y[n:, 0] + self._margin).mean()
        return loss
