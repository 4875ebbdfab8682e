"""The active set of a joint fit: the samples that cost something, or soon may, and the fields that matter to them.

Most samples of space cost nothing, and most fields are far from most samples. A refresh finds what could matter until f
has changed by a tolerance. Batches are drawn from that until the next refresh.
"""

from __future__ import annotations

import numpy as np
import torch

from ....arrays import F64, I64
from ...thread_pool import ThreadPool
from ..network.kernel import SpaceSamples, SurfaceSamples
from ..network.siren import Networks
from ..network.steps import Batches
from .counterexamples import CounterexampleSearch
from .sample_store import NO_FIELD, SampleStore
from .values import field_values

# Evidence for these constants: ADR 017.
TOLERANCE = 0.1  # how much f may change before a field that is left out of a sample could matter to it
RUN = 64  # samples in a row that are drawn together: side by side in memory is faster; their order is random


class ActiveSet:
    """Samples that batches are drawn from, and the fields that could matter to each.

    pool: rows of the space samples that could cost anything; of violations, those where f has the wrong sign, once
    more; and of the counterexamples of each side. owned: (K,) share of the surface samples to which each field was the
    nearest of those that see them, at the last refresh. on_surface, in_space: samples for the compiled loss, those of
    space in the order of the pool.
    """

    owned: F64
    on_surface: SurfaceSamples
    in_space: SpaceSamples

    def __init__(self, store: SampleStore, search: CounterexampleSearch, threads: ThreadPool) -> None:
        self._store, self._search, self._threads = store, search, threads
        # Until the first refresh everything matters.
        self._set_surface(torch.ones_like(store.seen))
        self._say = torch.ones_like(store.excluded)  # which fields could matter to a space sample
        everything = torch.arange(store.n_space)
        self._set_pool(everything, everything[:0])

    def refresh(self, networks: Networks, tolerance: float) -> None:
        """Add counterexamples to these networks, and find what could matter until f has changed by `tolerance`."""
        store = self._store
        for found in self._search.find(networks):
            store.add_counterexamples(*found)

        values = field_values(networks, store.surface, store.boxes, self._threads)
        own, owner = values.masked_fill(~store.seen, NO_FIELD).min(dim=1, keepdim=True)
        self._set_surface((values < tolerance) | (store.seen & (values <= own)))
        self.owned = (torch.bincount(owner[:, 0], minlength=len(networks)) / len(owner)).double().numpy()

        values = field_values(networks, store.space, store.boxes, self._threads)
        least = deciding_value(store, values)
        most = tolerance + torch.where(store.inside, store.margin, least)
        self._say = (values < most[:, None]) & (store.excluded | store.inside[:, None])
        hinge = store.margin + torch.where(store.inside, -least, least)
        active = torch.nonzero(hinge[: store.n_space] > -tolerance)[:, 0]
        self._set_pool(active, active[hinge[active] > store.margin[active].clamp(min=0)])

    def draw(self, n_surface: int, n_space: int, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw rows of surface and of space samples, from all there are. Half of the latter are from the last refresh,
        where it found any: a quarter violations, a quarter counterexamples."""
        found = self._quotas(n_space)
        rest = n_space - sum(n for _, _, n in found)
        nothing = np.empty(0, dtype=np.int64)
        places = np.concatenate([nothing, *(rng.integers(first, last, n) for first, last, n in found)])
        pooled = self.pool[torch.from_numpy(places)]
        surface = torch.from_numpy(rng.integers(self._store.n_surface, size=n_surface))
        space = torch.from_numpy(rng.integers(self._store.n_space, size=rest))
        return surface, torch.cat([space, pooled])

    def draw_steps(self, n_surface: int, n_space: int, count: int, rng: np.random.Generator) -> Batches:
        """As `draw`, for `count` steps before the next refresh: in runs, and without space samples that cost
        nothing."""
        parts = self._quotas(n_space)
        rest = n_space - sum(n for _, _, n in parts)
        parts.append((0, self._active, round(rest * self._active / self._store.n_space)))
        space = np.concatenate([_runs(*part, count, rng) for part in parts], axis=1)
        surface = _runs(0, self._store.n_surface, n_surface, count, rng)
        # The places of the pool stand for all of space.
        return Batches(surface, space, np.float32(1 / max(n_surface, 1)), np.float32(1 / max(n_space, 1)))

    def rows(self, batches: Batches) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the rows of surface and space samples of the first step, as `draw` does."""
        surface, space = (torch.from_numpy(part[0]) for part in (batches.surface, batches.space))
        return surface, self.pool[space]

    def _quotas(self, n_space: int) -> list[tuple[int, int, int]]:
        """Divide draws among violations and counterexamples: (first, last, count), for `count` draws of the places from
        `first` to `last` - 1 in the pool."""
        n_violations = len(self.pool) - self._active - sum(self._kept)
        ends = np.cumsum([self._active, n_violations, *self._kept])
        quarter = n_space // 4
        parts = [(int(ends[0]), int(ends[1]), quarter)] if n_violations else []
        # One side may have a hundred times as many counterexamples as the other, which matters as much.
        sides = [side for side in range(2) if self._kept[side]]
        counts = [len(part) for part in np.array_split(np.arange(quarter), len(sides))] if sides else []
        return parts + [(int(ends[1 + s]), int(ends[2 + s]), n) for s, n in zip(sides, counts, strict=True)]

    def _set_surface(self, say: torch.Tensor) -> None:
        store = self._store
        self.on_surface = SurfaceSamples(store.surface.numpy(), say.numpy(), store.seen.numpy(), store.cosine.numpy())

    def _set_pool(self, active: torch.Tensor, violations: torch.Tensor) -> None:
        store = self._store
        self._kept, self._active = store.kept, len(active)
        self.pool = at = torch.cat([active, violations, *(store.counterexamples(side) for side in range(2))])
        self.in_space = SpaceSamples(
            store.space[:, at].contiguous().numpy(),
            self._say[at].numpy(),
            store.excluded[at].numpy(),
            store.inside[at].numpy(),
            store.margin[at].numpy(),
            store.weight[at].numpy(),
        )


def deciding_value(store: SampleStore, values: torch.Tensor) -> torch.Tensor:
    """(M,): the one of values (M, K) that decides about each space sample. For one inside it is the least of all
    fields', for one outside the least of those that may exclude it."""
    outside = values.masked_fill(~store.excluded, NO_FIELD).amin(dim=1)
    return torch.where(store.inside, values.min(dim=1).values, outside)


def _runs(first: int, last: int, length: int, count: int, rng: np.random.Generator) -> I64:
    """Draw integers from first to last - 1, (count, length), in runs that start at random; `first` follows the last."""
    n = last - first
    if n == 0:
        return np.empty((count, 0), dtype=np.int64)
    run = min(RUN, n)
    starts = rng.integers(n, size=(count, -(-length // run)))
    at = (starts[..., None] + np.arange(run)).reshape(count, -1)[:, :length]
    return first + np.where(at < n, at, at - n)
