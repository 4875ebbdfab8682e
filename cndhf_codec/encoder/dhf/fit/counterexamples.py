"""Search for counterexamples that no sample sees: floaters in clear space, specks and slits nearer to the surface.

Near jumps of the heights, networks leave specks of solid, or cut slits into it, that may be smaller than the distance
between samples. The points found, with the truth about them, become samples that are drawn more often than others.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch

from ....arrays import F32, Mask
from ....format.container import fold
from ...thread_pool import ThreadPool
from ..frames import Frame
from ..network import kernel
from ..network.siren import Networks, heights
from .clear_space import ClearSpace
from .samples import CLEARANCE, Samples
from .values import POINTS_PER_CALL

# Evidence for these constants: ADR 018.
CLEAR_POINTS = 2**19  # points of clear space per search
BALL_POINTS = 2**17  # points nearer to the surface per search and side
# Points where f is wrong, or right by less than DOUBTFUL, are doubtful. The next searches also try points around the
# last REMEMBERED of them, at a standard deviation of SPREAD.
DOUBTFUL, REMEMBERED, SPREAD = 0.015, 2000, 0.01
# A doubtful point becomes a sample when f is wrong, or right by less than this: outside, inside. Inside they are few,
# and rounding cuts slits where there are none.
ADDED_BELOW = (0.005, DOUBTFUL)
MOST_FOUND = 4000  # most points of a kind whose truth a search finds
ARTIFACT_DRAWS = 8  # times CLEAR_POINTS are tried where artifacts are counted
OUTSIDE, INSIDE = 0, 1  # sides


class Counterexamples(NamedTuple):
    """Counterexamples of one side: points (N, 3) of the normalised frame, whether fields exclude them, (N, K), and
    their distance from the surface, (N,)."""

    side: int
    points: F32
    excluded: Mask
    distance: F32


class CounterexampleSearch:
    """Searches new points each time, and around earlier finds. Not for several threads at once."""

    def __init__(
        self, samples: Samples, clear: ClearSpace, frames: list[Frame], rng: np.random.Generator, threads: ThreadPool
    ) -> None:
        self._clear, self._frames, self._rng, self._threads = clear, frames, rng, threads
        self._rotations = _tensor(np.stack([f.rotation for f in frames])).mT
        off = samples.distance > CLEARANCE
        outside = samples.excluded.any(axis=1)
        # For each side: samples off the surface, and doubtful points of earlier searches.
        self._off = [(samples.space[off & m], samples.distance[off & m]) for m in (outside, ~outside)]
        self.remembered = [samples.space[:0], samples.space[:0]]

    def find(self, networks: Networks) -> Iterator[Counterexamples]:
        """Find points of clear space where f is above zero or nearly so, and points nearer to the surface where it is
        wrong or nearly so."""
        floaters = self.floaters(networks, -DOUBTFUL)[:MOST_FOUND]
        sides = [self.doubtful(networks, side) for side in (OUTSIDE, INSIDE)]
        parts = [floaters, *(points for points, _ in sides)]
        excluded, distance = self._clear.truth(np.concatenate(parts))
        ends = np.cumsum([len(p) for p in parts])[:-1]
        truth = list(zip(parts, np.split(excluded, ends), np.split(distance, ends), strict=True))
        points, excluded, distance = truth[0]
        found = excluded.any(axis=1)  # not in a hidden cavity, which the exact heights fill
        yield Counterexamples(OUTSIDE, points[found], excluded[found], distance[found])
        for side, (points, excluded, distance) in enumerate(truth[1:]):
            found = (excluded.any(axis=1) == (side == OUTSIDE)) & (distance > CLEARANCE)
            self.remembered[side] = np.concatenate([self.remembered[side], points[found]])[-REMEMBERED:]
            found &= sides[side][1] < ADDED_BELOW[side]
            yield Counterexamples(side, points[found], excluded[found], distance[found])

    def artifacts(self, networks: Networks) -> int:
        """Count the points found in floaters and in slits."""
        points, f = self.doubtful(networks, INSIDE)
        excluded, distance = self._clear.truth(points[f < 0])
        slits = ~excluded.any(axis=1) & (distance > CLEARANCE)
        return int(slits.sum()) + sum(len(self.floaters(networks, 0.0)) for _ in range(ARTIFACT_DRAWS))

    def doubtful(self, networks: Networks, side: int) -> tuple[F32, F32]:
        """Find points (N, 3) of a side where f is wrong or nearly so, and there f, for the outside -f, (N,).

        Points are drawn around samples: the ball around a sample that reaches to the surface is all on its side.
        """
        samples, depth = self._off[side]
        if not len(samples):
            return samples, depth
        at = self._rng.integers(len(samples), size=BALL_POINTS)
        away = self._rng.normal(size=(BALL_POINTS, 3))
        away *= ((depth[at] - CLEARANCE) * self._rng.random(BALL_POINTS) / np.linalg.norm(away, axis=1))[:, None]
        points = _tensor(samples[at] + away)
        remembered = self.remembered[side]
        if len(remembered):
            again = remembered[self._rng.integers(len(remembered), size=BALL_POINTS // 4)]
            points = torch.cat([points, _tensor(again + self._rng.normal(size=again.shape) * SPREAD)])

        def look(at: int) -> torch.Tensor:
            part = points[at : at + POINTS_PER_CALL]
            least = torch.full((len(part),), float(kernel.NO_FIELD))
            for k in range(len(networks)):
                least = torch.minimum(least, self._value(networks, k, part))
            return least if side == INSIDE else -least

        with torch.no_grad():
            f = torch.cat(self._threads.map(look, range(0, len(points), POINTS_PER_CALL)))
        # Points around remembered ones are many, most of them too near to the surface: they must not crowd out others.
        parts = f[:BALL_POINTS], f[BALL_POINTS:]
        fresh, again_at = (torch.nonzero(part < DOUBTFUL)[: MOST_FOUND // 2, 0] for part in parts)
        found = torch.cat([BALL_POINTS + again_at, fresh])
        return points[found].numpy(), f[found].numpy()

    def floaters(self, networks: Networks, level: float) -> F32:
        """Find points (N, 3) of clear space where f is above a level."""
        points = _tensor(self._clear.draw(CLEAR_POINTS, self._rng))

        def above(at: int) -> torch.Tensor:
            part = points[at : at + POINTS_PER_CALL]
            for k in range(len(networks)):
                part = part[self._value(networks, k, part) > level]
            return part

        with torch.no_grad():
            found = self._threads.map(above, range(0, len(points), POINTS_PER_CALL))
        return torch.cat([points[:0], *found]).numpy()

    def _value(self, networks: Networks, k: int, points: torch.Tensor) -> torch.Tensor:
        """(N,): min(far - z, z - near) of field k at points (N, 3) of the normalised frame."""
        x = points @ self._rotations[k]
        fold(x, self._frames[k].mirrors)
        y = heights(networks, k, x[:, :2])
        return torch.minimum(y[:, 1] - x[:, 2], x[:, 2] - y[:, 0])


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(array, dtype=torch.float32)
