"""The fit: one SIREN to one set of height targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Event, Lock

import numpy as np
import torch

from ....errors import EncodeError, OptionError
from ...deadline import Deadline
from ...settings import Settings
from ...thread_pool import Team
from ..frames import HeightTargets
from ..network.siren import Networks, forward, heights, initialise
from ..network.soap import Soap

OnSteps = Callable[[int, int, float], None]  # done, total, loss

WARM_UP = 100  # steps of rising learning rate
INSIDE = 0.75  # share of a batch drawn inside the silhouette
TILE = 16  # pixels along the side of the tiles that the Laplacian loss looks at
REPORT_EVERY = 20  # steps


def choose_device(name: str) -> torch.device:
    """The torch device for "cpu" or "cuda". Raises OptionError when there is no such device."""
    if name not in ("cpu", "cuda"):
        raise OptionError(f"device is {name!r}; there are cpu, cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError("device is 'cuda', but torch sees no CUDA device; use cpu")
    return torch.device(name)


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Torch's own threads cost more than they bring on tensors as small as these, and change the sums."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def fit_all(
    targets: list[HeightTargets],
    settings: list[Settings],
    seed: int,
    device: torch.device,
    team: Team,
    on_steps: OnSteps,
    deadline: Deadline,
) -> list[Networks]:
    """Fit every DHF alone, with settings of its own, side by side; for fewer steps when the deadline comes first.

    Each fit runs in one thread, so that the result does not depend on their number. Raises EncodeError when a fit
    diverges.
    """
    stop, lock = Event(), Lock()
    done = [0] * len(targets)
    losses = [math.nan] * len(targets)

    def one(i: int) -> Networks:
        def report(step: int, loss: float) -> None:
            with lock:
                done[i], losses[i] = step, loss
                on_steps(sum(done), sum(s.steps for s in settings), float(np.nanmean(losses)))

        try:
            return _fit(targets[i], settings[i], seed + i, device, stop, report, deadline)
        except BaseException:
            # Interrupted or failed: the other fits must not run on.
            stop.set()
            raise

    # A GPU is not shared.
    return (team if device.type == "cpu" else Team(1)).map(one, range(len(targets)))


def _fit(
    targets: HeightTargets,
    settings: Settings,
    seed: int,
    device: torch.device,
    stop: Event,
    report: Callable[[int, float], None],
    deadline: Deadline,
) -> Networks:
    width = settings.width
    assert width is not None, "a size has been turned into a width before the fit"
    generator = torch.Generator().manual_seed(seed)
    network = initialise(width, settings.hidden_layers, settings.omega, generator)
    theta = network.theta.to(device).requires_grad_()
    network = replace(network, theta=theta)
    loss_of = (_TileLoss if settings.laplacian else _PointLoss)(targets, settings, device, settings.batch)
    step_by = _adam(theta) if settings.optimiser == "adam" else Soap(network).step
    for step in range(1, settings.steps + 1):
        done = max((step - 1) / settings.steps, deadline.passed())
        if stop.is_set() or done >= 1:
            break
        loss = loss_of(network, generator)
        (gradient,) = torch.autograd.grad(loss, theta)
        with torch.no_grad():
            step_by(gradient, settings.learning_rate * cosine_schedule(step / WARM_UP, done))
        if step % REPORT_EVERY == 0 or step == settings.steps:
            value = loss.item()
            if not math.isfinite(value):
                raise EncodeError(f"the fit diverged at step {step}; try another --seed")
            report(step, value)
    return replace(network, theta=theta.detach().cpu())


def cosine_schedule(warm: float, done: float) -> float:
    """Share of the learning rate when a share of the work is done: it rises while `warm` goes to 1, and falls to 0
    along a cosine."""
    return min(1.0, warm) * 0.5 * (1 + math.cos(math.pi * done))


def _adam(theta: torch.Tensor) -> Callable[[torch.Tensor, float], None]:
    optimiser = torch.optim.Adam([theta])

    def step(gradient: torch.Tensor, rate: float) -> None:
        optimiser.param_groups[0]["lr"] = rate
        theta.grad = gradient
        optimiser.step()

    return step


class _Images:
    """A DHF's targets as tensors on a device, pixels flattened."""

    def __init__(self, t: HeightTargets, device: torch.device) -> None:
        def put(array: np.ndarray, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(device, dtype)

        self.device = device
        self.shape = t.hit.shape
        self.uv = put(t.uv.reshape(-1, 2))
        self.heights = put(np.stack([t.near.ravel(), t.far.ravel()], axis=1))
        self.known = put(np.stack([t.near_known.ravel(), t.far_known.ravel()], axis=1))
        self.hit = put(t.hit.ravel())
        self.inside = put(np.flatnonzero(t.hit), torch.int64)
        self.outside = put(np.flatnonzero(~t.hit), torch.int64)
        self.laplacians = put(np.stack([t.laplacian_near.ravel(), t.laplacian_far.ravel()], axis=1))
        self.laplacian_known = put(t.laplacian_known.ravel())

    def draw(self, n: int, count: int, generator: torch.Generator) -> torch.Tensor:
        """`count` integers below n, drawn on the CPU so that every device sees the same batches."""
        return torch.randint(n, (count,), generator=generator).to(self.device)


class _PointLoss:
    """L1 on the known heights of points inside the silhouette; a hinge at points outside it."""

    def __init__(self, t: HeightTargets, settings: Settings, device: torch.device, batch: int) -> None:
        self.images = _Images(t, device)
        self.settings = settings
        outside = len(self.images.outside)
        self.n_outside = round(batch * (1 - INSIDE)) if outside else 0
        self.n_inside = batch - self.n_outside

    def __call__(self, network: Networks, generator: torch.Generator) -> torch.Tensor:
        im, n = self.images, self.n_inside
        inside = im.inside[im.draw(len(im.inside), n, generator)]
        at = inside
        if self.n_outside:
            at = torch.cat([inside, im.outside[im.draw(len(im.outside), self.n_outside, generator)]])
        y = heights(network, 0, im.uv[at])
        loss = ((y[:n] - im.heights[inside]).abs() * im.known[inside]).sum() / n
        if self.n_outside:
            loss = loss + torch.relu(y[n:, 1] - y[n:, 0] + self.settings.margin).mean()
        return loss


class _TileLoss:
    """The paper's loss: L1, hinge, and L1 between the Laplacians of the height images, on random tiles."""

    def __init__(self, t: HeightTargets, settings: Settings, device: torch.device, batch: int) -> None:
        self.images = _Images(t, device)
        self.settings = settings
        self.tiles = max(1, batch // TILE**2)
        nu, nv = self.images.shape
        self.side = min(TILE, nu, nv)
        span = torch.arange(self.side)
        self.offsets = (span[:, None] * nv + span).to(device)

    def __call__(self, network: Networks, generator: torch.Generator) -> torch.Tensor:
        im, (nu, nv) = self.images, self.images.shape
        u = im.draw(nu - self.side + 1, self.tiles, generator)
        v = im.draw(nv - self.side + 1, self.tiles, generator)
        at = (u * nv + v)[:, None, None] + self.offsets
        y = forward(network, 0, im.uv[at])
        error = ((y - im.heights[at]).abs() * im.known[at]).sum(dim=-1)
        hinge = torch.relu(y[..., 1] - y[..., 0] + self.settings.margin) * (1 - im.hit[at])
        middle = at[:, 1:-1, 1:-1]
        laplacian = y[:, 2:, 1:-1] + y[:, :-2, 1:-1] + y[:, 1:-1, 2:] + y[:, 1:-1, :-2] - 4 * y[:, 1:-1, 1:-1]
        smooth = (laplacian - im.laplacians[middle]).abs().sum(dim=-1) * im.laplacian_known[middle]
        return error.mean() + hinge.mean() + self.settings.laplacian * smooth.mean()
