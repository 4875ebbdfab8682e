"""The composite loss: how far the intersection of all double height fields is from the samples of the solid.

Every sample is answered for by one height of one DHF, the active one:
- a surface point that f leaves outside, by the DHF that cuts it off; one that is inside, by that DHF, among those that
  see it, which is nearest to it. The loss is |f| times the cosine between normal and axis: the distance to the surface.
- a point of space, by the least of the DHFs when it is inside, by the least of those that may exclude it when it is
  outside. The loss is a hinge: the sign of f shall be right by a margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .heights import Frame
from .samples import Samples
from .siren import heights

MARGIN = 0.03  # most that f shall differ from zero off the surface (normalised units)
NEAR = 0.02  # a sample at distance d from the surface weighs 1 + d / NEAR: a floater costs its area times its distance
STRAY = 0.04  # a sample that is wrongly inside at this distance from the surface belongs to a floater
LOOK_AT_ONCE = 2**16
FAR = 1e3  # stands for "no such DHF"

Network = list[torch.Tensor]


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


class Composite:
    """Samples in the frame of every DHF, ready to be drawn from."""

    def __init__(self, samples: Samples, frames: list[Frame], omega: float, device: torch.device) -> None:
        self.device, self.omega = device, omega
        self.n_surface, self.n_space = len(samples.surface), len(samples.space)
        self._lo = [self._put(f.bounds[:, 0]) for f in frames]
        self._hi = [self._put(f.bounds[:, 1]) for f in frames]
        rotations = [self._put(f.rotation) for f in frames]
        surface, space = self._put(samples.surface), self._put(samples.space)
        self._surface = [surface @ r.T for r in rotations]
        self._space = [space @ r.T for r in rotations]
        self._seen = torch.from_numpy(samples.seen).to(device)
        self._cosine = self._put(samples.cosine)
        self._excluded = torch.from_numpy(samples.excluded).to(device)
        self._inside = ~self._excluded.any(dim=1)
        self._violations = torch.empty(0, dtype=torch.int64)
        self._distance = self._put(samples.distance)
        self._margin = (self._distance / 2).clamp(max=MARGIN)
        self._weight = 1 + self._distance / NEAR
        # Outside one of the boxes there is nothing that a network could get wrong.
        for x, lo, hi in zip(self._space, self._lo, self._hi, strict=True):
            self._margin[((x < lo) | (x > hi)).any(dim=1) & ~self._inside] = -FAR

    def draw(self, n_surface: int, n_space: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices of a random batch; half of its space samples are among those that `look_for_violations` found."""
        surface = torch.randint(self.n_surface, (n_surface,), generator=generator)
        space = torch.randint(self.n_space, (n_space,), generator=generator)
        if len(self._violations):
            half = n_space // 2
            space[:half] = self._violations[torch.randint(len(self._violations), (half,), generator=generator)]
        return surface.to(self.device), space.to(self.device)

    def strays(self, networks: list[Network]) -> int:
        """How many space samples far outside the solid are inside the networks' one: floaters."""
        self.look_for_violations(networks)
        found = self._violations.to(self.device)
        return int((self._distance[found] > STRAY).logical_and(~self._inside[found]).sum())

    def look_for_violations(self, networks: list[Network]) -> None:
        """Find the space samples on the wrong side of f: rare ones, floaters among them, are seldom drawn by chance."""
        found = []
        nothing = torch.empty(0, dtype=torch.int64, device=self.device)
        with torch.no_grad():
            for at in range(0, self.n_space, LOOK_AT_ONCE):
                part = torch.arange(at, min(at + LOOK_AT_ONCE, self.n_space), device=self.device)
                terms = self.terms(networks, nothing, part)
                found.append(part[(terms.argument > self._margin[part]) & (terms.cost > 0)])
        self._violations = torch.cat(found).cpu()

    def terms(self, networks: list[Network], surface: torch.Tensor, space: torch.Tensor) -> Terms:
        """Terms of the surface samples and then the space samples with these indices."""
        n = len(surface)
        slack, sides, uvs = [], [], []
        for k, network in enumerate(networks):
            x = torch.cat([self._surface[k][surface], self._space[k][space]])
            uv = torch.minimum(torch.maximum(x[:, :2], self._lo[k][:2]), self._hi[k][:2])
            y = heights(network, uv, self.omega)
            above, below = y[:, 1] - x[:, 2], x[:, 2] - y[:, 0]
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

    def _put(self, array: object) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32).to(self.device)
