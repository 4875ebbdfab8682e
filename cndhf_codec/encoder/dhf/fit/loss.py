"""The joint loss: how far the intersection of all double height fields is from the samples of the solid.

f is the least value of all fields. One height of one field answers for each sample:
- of a surface sample where f < 0, it is the field of least value; of one where f >= 0, the field of least value among
  those that see it. The loss is that |value| times |normal . axis|, the distance from the surface.
- of a space sample inside the solid, it is the field of least value; of one outside, the field of least value among
  those that may exclude it. The loss is a hinge: that value must have the right sign by a margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ....arrays import F32, F64, Mask
from ...thread_pool import ThreadPool
from ..frames import Frame
from ..network import kernel
from ..network.siren import Networks
from ..network.soap import Soap
from ..network.steps import APART, SHARDS, Batches, Output, StepPlan, not_waited_for, take_steps
from .active_set import ActiveSet, deciding_value
from .clear_space import ClearSpace
from .counterexamples import CounterexampleSearch
from .sample_store import NO_FIELD, SampleStore
from .samples import CLEARANCE, Samples
from .values import field_distances, field_values

# Evidence for these constants: ADR 018.
ARTIFACT_DISTANCE = 0.04  # a sample that is wrongly inside at this distance from the surface belongs to a floater


@dataclass(frozen=True, eq=False)
class Terms:
    """What a batch of B samples costs.

    cost: (B,) loss of each sample. argument: (B,) the value that answers (surface), or the argument of the hinge
    (space). weight: (B,) d cost / d |argument| where the cost is not zero. field: (B,) which field answers. side: (B,)
    with which height, 0 near, 1 far. uv: where each network is evaluated, one (B, 2) tensor per field.
    """

    cost: torch.Tensor
    argument: torch.Tensor
    weight: torch.Tensor
    field: torch.Tensor
    side: torch.Tensor
    uv: list[torch.Tensor]


class JointLoss:
    """The joint loss on samples of a solid. Not for several threads at once."""

    def __init__(self, samples: Samples, clear: ClearSpace, frames: list[Frame], threads: ThreadPool) -> None:
        self._threads = threads
        rng = np.random.default_rng(0)
        samples = samples.in_random_order(rng)
        self.store = SampleStore(samples, frames)
        self.search = CounterexampleSearch(samples, clear, frames, rng, threads)
        self.active = ActiveSet(self.store, self.search, threads)

    def shares(self, networks: Networks) -> list[float]:
        """Share of the loss that each network answers for, (K,)."""
        n = self.store.n_surface, self.store.n_space
        with torch.no_grad():
            terms = self.terms(networks, *(torch.arange(count) for count in n))
        cost = torch.cat([part / len(part) for part in terms.cost.double().split(n)])
        return (torch.bincount(terms.field, cost, minlength=len(networks)) / cost.sum()).tolist()

    def artifacts(self, networks: Networks) -> int:
        """Count the points in floaters and slits: wrongly inside far from the surface, or wrongly outside deep in the
        solid."""
        store, n = self.store, self.store.n_space
        least = deciding_value(store, field_values(networks, store.space, store.boxes, self._threads))[:n]
        inside, distance = store.inside[:n], store.distance[:n]
        floaters = (least > 0) & ~inside & (distance > ARTIFACT_DISTANCE)
        slits = (least < 0) & inside & (distance > CLEARANCE)
        return int((floaters | slits).sum()) + self.search.artifacts(networks)

    def gradient(self, networks: Networks, batches: Batches) -> tuple[torch.Tensor, float]:
        """Return the gradient in theta, (K, P), of the loss of the first step, and the loss. It is the mean cost of the
        batch's surface samples plus that of the space samples that the batch stands for."""
        none = np.zeros((0, len(networks)))
        out = self._run(networks, Soap(networks), batches.part(0, 1), none, None)
        return torch.from_numpy(out.gradients[0]), float(out.losses[0].sum())

    def descend(
        self, networks: Networks, optimiser: Soap, batches: Batches, rates: F64, held: torch.Tensor | None = None
    ) -> tuple[float, Mask]:
        """Take a step on each of S batches, in place, at learning rates (S, K). The first only starts the optimiser.

        held: (K, P) mask of the weights to leave as they are. Returns the last step's loss, and which networks have had
        a gradient, (K,).
        """
        if not optimiser.started:
            gradient, loss = self.gradient(networks, batches)
            pulled = gradient.any(dim=1).numpy()
            optimiser.start(gradient if held is None else gradient.masked_fill(held, 0))
            if len(batches.surface) == 1:
                return loss, pulled
            loss, others = self.descend(networks, optimiser, batches.part(1, len(batches.surface)), rates[1:], held)
            return loss, pulled | others
        out = self._run(networks, optimiser, batches, rates, held)
        return float(out.losses[-1].sum()), out.pulled

    def _run(
        self, networks: Networks, optimiser: Soap, batches: Batches, rates: F64, held: torch.Tensor | None
    ) -> Output:
        """Take the steps in all threads. Without rates the weights stay as they are."""
        theta: F32 = networks.theta.detach().numpy()
        loss = kernel.LossData(
            networks.kernel_shapes(), self.store.boxes.numpy(), self.active.on_surface, self.active.in_space
        )
        plan = StepPlan(*optimiser.plan(rates), np.zeros(theta.shape, np.bool_) if held is None else held.numpy())
        gradients = np.empty((SHARDS, *theta.shape), np.float32)
        out = Output(gradients, np.empty((len(batches.surface), SHARDS)), np.zeros(len(networks), np.bool_))
        threads = min(self._threads.threads, SHARDS)
        counters = np.zeros(threads * APART, np.int64)

        def run(me: int) -> None:
            with not_waited_for(counters):
                take_steps(me, counters, theta, loss, batches, optimiser.state, plan, out)

        with not_waited_for(counters):  # this thread may be interrupted before it runs
            self._threads.map(run, range(threads))
        return out

    def terms(self, networks: Networks, surface: torch.Tensor, space: torch.Tensor) -> Terms:
        """Evaluate, in torch, the terms of the surface samples and then of the space samples in these rows."""
        store, n = self.store, len(surface)
        values, far_decides, uvs = [], [], []
        for k in range(len(networks)):
            x = torch.cat([store.surface[k][surface], store.space[k][space]])
            uv, above, below = field_distances(networks, k, x, store.boxes[k])
            values.append(torch.minimum(above, below))
            far_decides.append(above < below)
            uvs.append(uv)
        f, side = torch.stack(values, dim=1), torch.stack(far_decides, dim=1)

        cut, cutter = f[:n].min(dim=1)
        own, owner = f[:n].masked_fill(~store.seen[surface], NO_FIELD).min(dim=1)
        on_surface = torch.where(cut < 0, cut, own)
        who = torch.where(cut < 0, cutter, owner)
        cosine = store.cosine[surface].gather(1, who[:, None])[:, 0]

        inside, margin = store.inside[space], store.margin[space]
        least, holder = f[n:].min(dim=1)
        over, carver = f[n:].masked_fill(~store.excluded[space], NO_FIELD).min(dim=1)
        hinge = margin + torch.where(inside, -least, over)
        weight = store.weight[space]
        field = torch.cat([who, torch.where(inside, holder, carver)])
        return Terms(
            cost=torch.cat([on_surface.abs() * cosine, weight * torch.relu(hinge)]),
            argument=torch.cat([on_surface, hinge]),
            weight=torch.cat([cosine, weight]),
            field=field,
            side=side.gather(1, field[:, None])[:, 0].long(),
            uv=uvs,
        )
