"""The search for what samples miss: floaters in far space, specks of solid and slits nearer to the surface.

Near jumps of the heights, networks leave specks of solid, or cut slits into it, that may be smaller than the samples
lie apart. What is found, with the truth about it, become samples that are drawn more often than others.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import torch

from ....arrays import F32, Mask
from ....format.container import fold
from ...thread_pool import Team
from ..frames import Frame
from ..network import kernel
from ..network.siren import Networks, heights
from .samples import CLEAR, FarSpace, Samples

Found = tuple[int, F32, Mask, F32]  # side, points (N, 3), excluded (N, K), distance (N,)

FAR_POINTS = 2**19  # of far space that a search looks at
NEAR_POINTS = 2**17  # nearer to the surface, on each side
LOW, KNOWN, AROUND = 0.015, 2000, 0.01  # how near to zero f makes it look around next time, at how many points, how far
# What is found near the surface becomes a sample when f has the wrong sign, or is as close to zero: outside, inside.
# Inside they are few, and rounding cuts slits where none of them holds it.
SUSPECT = (0.005, LOW)
AT_MOST = 4000  # points of a kind that a search asks the truth about
AT_ONCE = 2**15  # points that a thread evaluates
OUTSIDE, INSIDE = 0, 1  # sides


class Hunt:
    """Looks at other points each time, and around those where f was low before. Not for several threads at once."""

    def __init__(
        self,
        samples: Samples,
        far: FarSpace,
        frames: list[Frame],
        rng: np.random.Generator,
        device: torch.device,
        team: Team,
    ) -> None:
        self._far, self._frames, self._rng, self._device, self._team = far, frames, rng, device, team
        self._rotations = self._put(np.stack([f.rotation for f in frames])).mT
        off = samples.distance > CLEAR
        outside = samples.excluded.any(axis=1)
        # Of each side: samples off the surface, and where f was found to be low.
        self._off = [(samples.space[off & m], samples.distance[off & m]) for m in (outside, ~outside)]
        self.known = [samples.space[:0], samples.space[:0]]

    def suspects(self, networks: Networks) -> Iterator[Found]:
        """What is to be added to the samples of each side: far points where f is about to rise above zero, and points
        nearer to the surface where it is about to be wrong."""
        floaters = self.floaters(networks, -LOW)[:AT_MOST]
        sides = [self.doubtful(networks, side) for side in (OUTSIDE, INSIDE)]
        parts = [floaters, *(points for points, _ in sides)]
        excluded, distance = self._far.truth(np.concatenate(parts))
        ends = np.cumsum([len(p) for p in parts])[:-1]
        truth = list(zip(parts, np.split(excluded, ends), np.split(distance, ends), strict=True))
        points, excluded, distance = truth[0]
        found = excluded.any(axis=1)  # nor can the exact heights empty a hidden cavity
        yield OUTSIDE, points[found], excluded[found], distance[found]
        for side, (points, excluded, distance) in enumerate(truth[1:]):
            found = (excluded.any(axis=1) == (side == OUTSIDE)) & (distance > CLEAR)
            self.known[side] = np.concatenate([self.known[side], points[found]])[-KNOWN:]
            found &= sides[side][1] < SUSPECT[side]
            yield side, points[found], excluded[found], distance[found]

    def strays(self, networks: Networks) -> int:
        """How many points are found in floaters and in slits."""
        points, f = self.doubtful(networks, INSIDE)
        excluded, distance = self._far.truth(points[f < 0])
        slits = ~excluded.any(axis=1) & (distance > CLEAR)
        return int(slits.sum()) + sum(len(self.floaters(networks, 0.0)) for _ in range(8))

    def doubtful(self, networks: Networks, side: int) -> tuple[F32, F32]:
        """Points of a side where f is wrong or nearly so, (N, 3), and f (N,), for the outside -f.

        A sample at a distance d from the surface has a ball of that radius around it which is all on its side.
        """
        samples, depth = self._off[side]
        if not len(samples):
            return samples, depth
        at = self._rng.integers(len(samples), size=NEAR_POINTS)
        away = self._rng.normal(size=(NEAR_POINTS, 3))
        away *= ((depth[at] - CLEAR) * self._rng.random(NEAR_POINTS) / np.linalg.norm(away, axis=1))[:, None]
        points = self._put(samples[at] + away)
        known = self.known[side]
        if len(known):
            near = known[self._rng.integers(len(known), size=NEAR_POINTS // 4)]
            points = torch.cat([points, self._put(near + self._rng.normal(size=near.shape) * AROUND)])

        def look(at: int) -> torch.Tensor:
            part = points[at : at + AT_ONCE]
            least = torch.full((len(part),), kernel.FAR, device=self._device)
            for k in range(len(networks)):
                least = torch.minimum(least, self._slack(networks, k, part))
            return least if side == INSIDE else -least

        with torch.no_grad():
            f = torch.cat(self._team.map(look, range(0, len(points), AT_ONCE)))
        # Around what was known there are many, most of them too near to the surface: the others must not be cut off.
        fresh, around = (torch.nonzero(part < LOW)[: AT_MOST // 2, 0] for part in (f[:NEAR_POINTS], f[NEAR_POINTS:]))
        found = torch.cat([NEAR_POINTS + around, fresh])
        return points[found].cpu().numpy(), f[found].cpu().numpy()

    def floaters(self, networks: Networks, level: float) -> F32:
        """(N, 3) points of far space where f is above a level."""
        points = self._put(self._far.draw(FAR_POINTS, self._rng))

        def above(at: int) -> torch.Tensor:
            part = points[at : at + AT_ONCE]
            for k in range(len(networks)):
                part = part[self._slack(networks, k, part) > level]
            return part

        with torch.no_grad():
            found = self._team.map(above, range(0, len(points), AT_ONCE))
        return torch.cat([points[:0], *found]).cpu().numpy()

    def _slack(self, networks: Networks, k: int, points: torch.Tensor) -> torch.Tensor:
        """(N,): min(far - z, z - near) of DHF k at points (N, 3) of the normalised frame."""
        x = points @ self._rotations[k]
        fold(x, self._frames[k].mirrors)
        y = heights(networks, k, x[:, :2])
        return torch.minimum(y[:, 1] - x[:, 2], x[:, 2] - y[:, 0])

    def _put(self, array: npt.NDArray[np.floating]) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32).to(self._device)
