"""The composite loss: how far the intersection of all double height fields is from the samples of the solid.

Every sample is answered for by one height of one DHF, the active one:
- a surface point that f leaves outside, by the DHF that cuts it off; one that is inside, by that DHF, among those that
  see it, which is nearest to it. The loss is |f| times the cosine between normal and axis: the distance to the surface.
- a point of space, by the least of the DHFs when it is inside, by the least of those that may exclude it when it is
  outside. The loss is a hinge: the sign of f shall be right by a margin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from ....arrays import F32, F64, I64, Mask
from ....format.container import fold
from ...thread_pool import Team
from ..frames import Frame
from ..network import kernel
from ..network.siren import Networks, heights
from ..network.soap import Soap
from ..network.steps import APART, SHARDS, not_waited_for, take_steps
from .counterexamples import AT_ONCE, Hunt
from .samples import CLEAR, FarSpace, Samples

MARGIN = 0.03  # most that f shall differ from zero off the surface (normalised units)
OFF_SURFACE = 0.4  # weight of a sample of space beside 1 of one on the surface and of a suspect
NEAR = 0.02  # at distance d from the surface 1 + d / NEAR times that: a floater costs its area times its distance
BEYOND = 10.0  # times as much weighs a sample outside the input's bounding box
STRAY = 0.04  # a sample that is wrongly inside at this distance from the surface belongs to a floater
SUSPECTS = 20_000  # of what a search finds, how many are kept of each side, the latest
REACH = 0.1  # how much f must change before a network that is left out of a sample has a say in what it costs
RUN = 64  # samples in a row that are drawn together: they lie side by side in memory, in random order
FAR = float(kernel.FAR)


@dataclass(frozen=True, eq=False)
class Terms:
    """What a batch of B samples costs.

    cost: (B,) loss of each sample. argument: (B,) f (surface) or argument of the hinge (space). weight: (B,)
    d cost / d |argument| where it is not zero. dhf: (B,) active DHF.
    side: (B,) its active height, 0 near, 1 far. uv: one (B, 2) tensor a DHF.
    """

    cost: torch.Tensor
    argument: torch.Tensor
    weight: torch.Tensor
    dhf: torch.Tensor
    side: torch.Tensor
    uv: list[torch.Tensor]


@dataclass(frozen=True, eq=False)
class Batches:
    """Samples of S steps. surface: (S, B) rows of the surface samples. space: (S, C) places in the pool, which stand
    for `of` draws among all of space."""

    surface: I64
    space: I64
    of: int

    def __len__(self) -> int:
        return len(self.surface)

    def part(self, first: int, last: int) -> Batches:
        return Batches(self.surface[first:last], self.space[first:last], self.of)


class Composite:
    """Samples in the frame of every DHF, ready to be drawn from.

    Most samples of space cost nothing, and most DHFs are far from most samples. `look` finds what matters to some
    networks: the pool of the space samples that batches are drawn from, and which DHFs are near a sample. The networks
    may then change for some steps before it must look again.

    owned: (K,) share of the surface samples that are nearest to each DHF, of those that see them, at the last look.
    """

    owned: F64

    def __init__(self, samples: Samples, far: FarSpace, frames: list[Frame], device: torch.device, team: Team) -> None:
        self.device, self._team = device, team
        self.n_surface, self.n_space = len(samples.surface), len(samples.space)
        rng = np.random.default_rng(0)
        samples = samples.in_random_order(rng)
        self._frames = frames
        self._boxes = self._put(np.stack([f.bounds for f in frames]))
        self._rotations = self._put(np.stack([f.rotation for f in frames])).mT
        self._surface = self._in_frames(samples.surface)
        self._seen = torch.from_numpy(samples.seen).to(device)
        self._cosine = self._put(samples.cosine)
        self._box = self._put(samples.box)
        self.hunt = Hunt(samples, far, frames, rng, device, team)
        self._suspects = [0, 0]  # outside, inside

        # The samples of space, and after them room for suspects.
        total = self.n_space + 2 * SUSPECTS
        self._space = torch.zeros((len(frames), total, 3), device=device)
        self._excluded = torch.zeros((total, len(frames)), dtype=torch.bool, device=device)
        self._inside = torch.zeros(total, dtype=torch.bool, device=device)
        self._distance, self._margin, self._weight = (torch.zeros(total, device=device) for _ in range(3))
        self._set_space(torch.arange(self.n_space), samples.space, samples.excluded, samples.distance, OFF_SURFACE)

        # Until a look is taken everything matters.
        self._near_surface = torch.ones_like(self._seen)
        self._near_space = torch.ones_like(self._excluded)
        self._set_pool(torch.arange(self.n_space, device=device))

    def _set_space(
        self, rows: torch.Tensor, points: np.ndarray, excluded: np.ndarray, distance: np.ndarray, weight: float
    ) -> None:
        self._space[:, rows] = self._in_frames(points)
        self._excluded[rows] = torch.from_numpy(excluded).to(self.device)
        self._inside[rows] = ~self._excluded[rows].any(dim=1)
        self._distance[rows] = self._put(distance)
        p = self._put(points)
        out = ((p < self._box[0]) | (p > self._box[1])).any(dim=1)
        self._weight[rows] = (1 + self._distance[rows] / NEAR) * torch.where(out, BEYOND, 1.0) * weight
        # Outside one of the boxes there is nothing that a network could get wrong.
        lo, hi = self._boxes[:, None, :, 0], self._boxes[:, None, :, 1]
        beyond = ((self._space[:, rows] < lo) | (self._space[:, rows] > hi)).any(dim=2).any(dim=0)
        margin = (self._distance[rows] / 2).clamp(max=MARGIN)
        self._margin[rows] = margin.masked_fill(beyond & ~self._inside[rows], -FAR)

    def draw(self, n_surface: int, n_space: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Rows of surface and of space samples, all of which may be drawn. A half of the latter are among what `look`
        found, where it found any: a quarter violations, a quarter suspects."""
        found = self._shares(n_space)
        rest = n_space - sum(n for _, _, n in found)
        nothing = np.empty(0, dtype=np.int64)
        places = np.concatenate([nothing, *(rng.integers(first, last, n) for first, last, n in found)])
        pooled = self._pool[torch.from_numpy(places).to(self.device)]
        surface = torch.from_numpy(rng.integers(self.n_surface, size=n_surface)).to(self.device)
        space = torch.from_numpy(rng.integers(self.n_space, size=rest)).to(self.device)
        return surface, torch.cat([space, pooled])

    def draw_batches(self, n_surface: int, n_space: int, count: int, rng: np.random.Generator) -> Batches:
        """As `draw`, for `count` steps before the next look: in runs, and without the space samples that cost
        nothing."""
        parts = self._shares(n_space)
        rest = n_space - sum(n for _, _, n in parts)
        parts.append((0, self._active, round(rest * self._active / self.n_space)))
        space = np.concatenate([_runs(*part, count, rng) for part in parts], axis=1)
        return Batches(_runs(0, self.n_surface, n_surface, count, rng), space, n_space)

    def rows(self, batch: Batches) -> tuple[torch.Tensor, torch.Tensor]:
        """The rows of the surface and space samples of the first step, as `draw` gives them."""
        surface, space = (torch.from_numpy(part[0]).to(self.device) for part in (batch.surface, batch.space))
        return surface, self._pool[space]

    def _shares(self, n_space: int) -> list[tuple[int, int, int]]:
        """Of `n_space` draws, how many are among the violations and the suspects: (first, last, count), places in the
        pool."""
        n_found = len(self._pool) - self._active - sum(self._kept)
        ends = np.cumsum([self._active, n_found, *self._kept])
        quarter = n_space // 4
        parts = [(int(ends[0]), int(ends[1]), quarter)] if n_found else []
        # Those of one side may be a hundred times as many as those of the other, which matter as much.
        sides = [side for side in range(2) if self._kept[side]]
        counts = [len(part) for part in np.array_split(np.arange(quarter), len(sides))] if sides else []
        return parts + [(int(ends[1 + s]), int(ends[2 + s]), n) for s, n in zip(sides, counts, strict=True)]

    def shares(self, networks: Networks) -> list[float]:
        """(K,) share of the loss that each network answers for."""
        n = self.n_surface, self.n_space
        with torch.no_grad():
            terms = self.terms(networks, *(torch.arange(count, device=self.device) for count in n))
        cost = torch.cat([part / len(part) for part in terms.cost.double().split(n)])
        return (torch.bincount(terms.dhf, cost, minlength=len(networks)) / cost.sum()).tolist()

    def strays(self, networks: Networks) -> int:
        """How many points are wrongly inside the networks' solid, far outside the truth, or wrongly outside, deep in
        it: of floaters and of slits."""
        least = self._least(self._slacks(networks, self._space))[: self.n_space]
        inside, distance = self._inside[: self.n_space], self._distance[: self.n_space]
        wrong = (least > 0) & ~inside & (distance > STRAY) | (least < 0) & inside & (distance > CLEAR)
        return int(wrong.sum()) + self.hunt.strays(networks)

    def look(self, networks: Networks, reach: float) -> None:
        """Find what matters to some networks until f has changed by `reach`.

        That is: which DHFs are near which samples, and which share of the surface is each one's (`owned`); the space
        samples that cost something or then might; and what is seldom drawn by chance: those on the wrong side of f, and
        suspects, points of far space where f is about to rise above zero and points nearer to the surface where it is
        about to be wrong.
        """
        for side, points, excluded, distance in self.hunt.suspects(networks):
            self._add_suspects(side, points, excluded, distance)

        slack = self._slacks(networks, self._surface)
        own, owner = slack.masked_fill(~self._seen, FAR).min(dim=1, keepdim=True)
        self._near_surface = (slack < reach) | (self._seen & (slack <= own))
        self.owned = (torch.bincount(owner[:, 0], minlength=len(networks)) / len(owner)).cpu().double().numpy()

        slack = self._slacks(networks, self._space)
        least = self._least(slack)
        near = reach + torch.where(self._inside, self._margin, least)
        self._near_space = (slack < near[:, None]) & (self._excluded | self._inside[:, None])
        hinge = self._margin + torch.where(self._inside, -least, least)
        self._set_pool(torch.nonzero(hinge[: self.n_space] > -reach)[:, 0], hinge)

    def _set_pool(self, active: torch.Tensor, hinge: torch.Tensor | None = None) -> None:
        """What batches are drawn from: rows of the active space samples, of those of them that are violations (where
        f has the wrong sign), and of the suspects of each side."""
        violations = active[:0] if hinge is None else active[hinge[active] > self._margin[active].clamp(min=0)]
        self._kept = [min(n, SUSPECTS) for n in self._suspects]
        suspects = [self.n_space + s * SUSPECTS + torch.arange(n, device=self.device) for s, n in enumerate(self._kept)]
        self._active, self._pool = len(active), torch.cat([active, violations, *suspects])
        at = self._pool
        self._in_pool = (
            self._space[:, at].contiguous(),
            self._near_space[at],
            self._excluded[at],
            self._inside[at],
            self._margin[at],
            self._weight[at],
        )

    def _slacks(self, networks: Networks, points: torch.Tensor) -> torch.Tensor:
        """(N, K): min(far - z, z - near) of every DHF at points (K, N, 3) in their frames."""

        def look(at: int) -> torch.Tensor:
            parts = []
            for k in range(len(networks)):
                _, above, below = self._distances(networks, k, points[k, at : at + AT_ONCE])
                parts.append(torch.minimum(above, below))
            return torch.stack(parts, dim=1)

        with torch.no_grad():
            return torch.cat(self._team.map(look, range(0, points.shape[1], AT_ONCE)))

    def _add_suspects(self, side: int, points: np.ndarray, excluded: np.ndarray, distance: np.ndarray) -> None:
        numbers = (self._suspects[side] + np.arange(len(points))) % SUSPECTS
        rows = self.n_space + side * SUSPECTS + numbers
        self._set_space(torch.from_numpy(rows), points, excluded, distance, 1.0)
        self._suspects[side] += len(rows)

    def _least(self, slack: torch.Tensor) -> torch.Tensor:
        """(N,): the slack that decides about each space sample: the least of all for one that is inside, of those DHFs
        that may exclude it for one that is outside."""
        return torch.where(self._inside, slack.min(dim=1).values, slack.masked_fill(~self._excluded, FAR).amin(dim=1))

    def gradient(self, networks: Networks, batch: Batches) -> tuple[torch.Tensor, float]:
        """(K, P) gradient in theta of the loss of the first step, and the loss: the mean cost of the batch's surface
        samples and that of the space samples that it stands for, added."""
        if self.device.type != "cpu":
            theta = networks.theta.detach().requires_grad_()
            n = batch.surface.shape[1]
            cost = self.terms(replace(networks, theta=theta), *self.rows(batch)).cost
            loss = cost[:n].mean() + cost[n:].sum() / batch.of
            return torch.autograd.grad(loss, theta)[0], loss.item()
        none = np.zeros((0, len(networks)))
        gradient, losses, _ = self._take_steps(networks, Soap(networks), batch.part(0, 1), none, None)
        return torch.from_numpy(gradient), losses[0]

    def descend(
        self,
        networks: Networks,
        optimiser: Soap,
        batches: Batches,
        rates: F64,
        held: torch.Tensor | None = None,
    ) -> tuple[float, Mask]:
        """Change the networks in place by a step on each of the batches, at learning rates (S, K). held: (K, P) mask of
        the weights to leave as they are. Returns the last step's loss, and, (K,), at which networks any step pulled."""
        if self.device.type == "cpu" and optimiser.started:
            _, losses, pulled = self._take_steps(networks, optimiser, batches, rates, held)
            return losses[-1], pulled
        pulled, loss = np.zeros(len(networks), np.bool_), 0.0
        for s, rate in enumerate(rates):
            gradient, loss = self.gradient(networks, batches.part(s, s + 1))
            pulled |= gradient.any(dim=1).cpu().numpy()
            before = networks.theta.clone()
            optimiser.step(gradient if held is None else gradient.masked_fill(held, 0), rate)
            if held is not None:
                torch.where(held, before, networks.theta, out=networks.theta)
        return loss, pulled

    def _take_steps(
        self,
        networks: Networks,
        optimiser: Soap,
        batches: Batches,
        rates: F64,
        held: torch.Tensor | None,
    ) -> tuple[F32, list[float], Mask]:
        """On the CPU: (K, P) gradient of the last step, (S,) losses, and what was pulled at; see `steps.take_steps`."""
        theta = networks.theta.detach().numpy()
        of_networks = (
            np.array(networks.widths),
            np.array(networks.counts),
            networks.hidden_layers + 1,
            np.array(networks.omegas, dtype=np.float32),
        )
        on_surface = tuple(t.numpy() for t in (self._surface, self._near_surface, self._seen, self._cosine))
        scales, refreshes = optimiser.plan(rates)
        mask = np.zeros(theta.shape, np.bool_) if held is None else held.numpy()
        gradients = np.empty((SHARDS, *theta.shape), np.float32)
        losses, pulled = np.empty((len(batches), SHARDS)), np.zeros(len(networks), np.bool_)
        threads = min(self._team.threads, SHARDS)
        counters = np.zeros(threads * APART, np.int64)

        def run(me: int) -> None:
            with not_waited_for(counters):
                take_steps(
                    me,
                    threads,
                    counters,
                    theta,
                    of_networks,
                    self._boxes.numpy(),
                    on_surface,
                    tuple(t.numpy() for t in self._in_pool),
                    batches.surface,
                    batches.space,
                    np.float32(1 / max(batches.surface.shape[1], 1)),
                    np.float32(1 / max(batches.of, 1)),
                    optimiser.state,
                    scales,
                    refreshes,
                    mask,
                    gradients,
                    losses,
                    pulled,
                )

        with not_waited_for(counters):  # this thread may be interrupted before it runs
            self._team.map(run, range(threads))
        return gradients[0], losses.sum(axis=1).tolist(), pulled

    def terms(self, networks: Networks, surface: torch.Tensor, space: torch.Tensor) -> Terms:
        """Terms of the surface samples and then the space samples with these indices."""
        n = len(surface)
        slack, sides, uvs = [], [], []
        for k in range(len(networks)):
            x = torch.cat([self._surface[k][surface], self._space[k][space]])
            uv, above, below = self._distances(networks, k, x)
            slack.append(torch.minimum(above, below))
            sides.append(above < below)
            uvs.append(uv)
        f, side = torch.stack(slack, dim=1), torch.stack(sides, dim=1)

        cut, cutter = f[:n].min(dim=1)
        own, owner = f[:n].masked_fill(~self._seen[surface], FAR).min(dim=1)
        on_surface = torch.where(cut < 0, cut, own)
        who = torch.where(cut < 0, cutter, owner)
        cosine = self._cosine[surface].gather(1, who[:, None])[:, 0]

        inside, margin = self._inside[space], self._margin[space]
        least, holder = f[n:].min(dim=1)
        over, carver = f[n:].masked_fill(~self._excluded[space], FAR).min(dim=1)
        hinge = margin + torch.where(inside, -least, over)
        weight = self._weight[space]
        dhf = torch.cat([who, torch.where(inside, holder, carver)])
        return Terms(
            cost=torch.cat([on_surface.abs() * cosine, weight * torch.relu(hinge)]),
            argument=torch.cat([on_surface, hinge]),
            weight=torch.cat([cosine, weight]),
            dhf=dhf,
            side=side.gather(1, dhf[:, None])[:, 0].long(),
            uv=uvs,
        )

    def _distances(
        self, networks: Networks, k: int, x: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Of points (N, 3) in DHF k's frame: where its network is asked, (N, 2), and far - z and z - near, (N,)."""
        uv = torch.minimum(torch.maximum(x[:, :2], self._boxes[k, :2, 0]), self._boxes[k, :2, 1])
        y = heights(networks, k, uv)
        return uv, y[:, 1] - x[:, 2], x[:, 2] - y[:, 0]

    def _in_frames(self, points: np.ndarray) -> torch.Tensor:
        """(K, N, 3): points (N, 3) in the frame of every DHF, on the side of its mirrors that the network describes."""
        uvz = self._put(points) @ self._rotations
        for x, frame in zip(uvz, self._frames, strict=True):
            fold(x, frame.mirrors)
        return uvz

    def _put(self, array: object) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32).to(self.device)


def _runs(first: int, last: int, length: int, count: int, rng: np.random.Generator) -> I64:
    """(count, length): each row has integers from first to last - 1, in runs from random places on; the first follows
    the last."""
    n = last - first
    if n == 0:
        return np.empty((count, 0), dtype=np.int64)
    run = min(RUN, n)
    starts = rng.integers(n, size=(count, -(-length // run)))
    at = (starts[..., None] + np.arange(run)).reshape(count, -1)[:, :length]
    return first + np.where(at < n, at, at - n)
