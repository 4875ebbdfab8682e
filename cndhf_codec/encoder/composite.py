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

from ..format.container import fold
from . import kernel
from .heights import Frame
from .samples import CLEAR, FarSpace, Samples
from .siren import Networks, heights
from .team import Team

MARGIN = 0.03  # most that f shall differ from zero off the surface (normalised units)
NEAR = 0.02  # a sample at distance d from the surface weighs 1 + d / NEAR: a floater costs its area times its distance
BEYOND = 10.0  # times as much weighs a sample outside the input's bounding box
STRAY = 0.04  # a sample that is wrongly inside at this distance from the surface belongs to a floater
LOOK_AT_ONCE = 2**15
HUNT = 2**19  # points of far space that a search for floaters looks at
HUNT_NEAR = 2**17  # points nearer to the surface, on each side, that a search for specks and slits looks at
LOW, KNOWN, AROUND = 0.015, 2000, 0.01  # how near to zero f makes it look around next time, at how many points, how far
SUSPECT = 0.005  # what is found near the surface becomes a sample when f has the wrong sign, or is as close to zero
SUSPECTS = 10_000  # of them that are kept of each side, the latest
SHARDS = 4  # pieces of a batch that threads work on; as many on every machine, so that their sum is the same
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


class Composite:
    """Samples in the frame of every DHF, ready to be drawn from."""

    def __init__(self, samples: Samples, far: FarSpace, frames: list[Frame], device: torch.device, team: Team) -> None:
        self.device, self._team, self._far = device, team, far
        self.n_surface, self.n_space = len(samples.surface), len(samples.space)
        self._frames = frames
        self._boxes = self._put(np.stack([f.bounds for f in frames]))
        self._rotations = self._put(np.stack([f.rotation for f in frames])).mT
        self._surface = self._in_frames(samples.surface)
        self._seen = torch.from_numpy(samples.seen).to(device)
        self._cosine = self._put(samples.cosine)
        self._box = self._put(samples.box)
        off = samples.distance > CLEAR
        outside = samples.excluded.any(axis=1)
        # Of each side, outside and inside: samples off the surface, and where f was found to be low.
        self._off = [(samples.space[off & m], samples.distance[off & m]) for m in (outside, ~outside)]
        self._known = [samples.space[:0], samples.space[:0]]
        self._hunter = np.random.default_rng(0)
        self._suspects = [0, 0]  # outside, inside
        self._violations = torch.empty(0, dtype=torch.int64)

        # The samples of space, and after them room for suspects.
        total = self.n_space + 2 * SUSPECTS
        self._space = torch.empty((len(frames), total, 3), device=device)
        self._excluded = torch.empty((total, len(frames)), dtype=torch.bool, device=device)
        self._inside = torch.empty(total, dtype=torch.bool, device=device)
        self._distance, self._margin, self._weight = (torch.empty(total, device=device) for _ in range(3))
        self._set_space(torch.arange(self.n_space), samples.space, samples.excluded, samples.distance)

    def _set_space(self, rows: torch.Tensor, points: np.ndarray, excluded: np.ndarray, distance: np.ndarray) -> None:
        self._space[:, rows] = self._in_frames(points)
        self._excluded[rows] = torch.from_numpy(excluded).to(self.device)
        self._inside[rows] = ~self._excluded[rows].any(dim=1)
        self._distance[rows] = self._put(distance)
        p = self._put(points)
        out = ((p < self._box[0]) | (p > self._box[1])).any(dim=1)
        self._weight[rows] = (1 + self._distance[rows] / NEAR) * torch.where(out, BEYOND, 1.0)
        # Outside one of the boxes there is nothing that a network could get wrong.
        lo, hi = self._boxes[:, None, :, 0], self._boxes[:, None, :, 1]
        beyond = ((self._space[:, rows] < lo) | (self._space[:, rows] > hi)).any(dim=2).any(dim=0)
        margin = (self._distance[rows] / 2).clamp(max=MARGIN)
        self._margin[rows] = margin.masked_fill(beyond & ~self._inside[rows], -FAR)

    def draw(self, n_surface: int, n_space: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices of a random batch. A half of its space samples are among what `look_for_violations` found, where it
        found any: a quarter violations, a quarter suspects."""
        surface = torch.randint(self.n_surface, (n_surface,), generator=generator)
        space = torch.randint(self.n_space, (n_space,), generator=generator)
        quarter = n_space // 4
        if len(self._violations):
            space[:quarter] = self._violations[torch.randint(len(self._violations), (quarter,), generator=generator)]
        # Those of one side may be a hundred times as many as those of the other, which matter as much.
        sides = [side for side in range(2) if self._suspects[side]]
        for side, part in zip(sides, space[-quarter:].tensor_split(max(len(sides), 1)), strict=False):
            count = min(self._suspects[side], SUSPECTS)
            part[:] = self.n_space + side * SUSPECTS + torch.randint(count, part.shape, generator=generator)
        return surface.to(self.device), space.to(self.device)

    def strays(self, networks: Networks) -> int:
        """How many points far outside the solid are inside the networks' one: floaters."""
        found = self._violations_of(networks)
        known = int((self._distance[found] > STRAY).logical_and(~self._inside[found]).sum())
        return known + sum(len(self._floaters(networks, 0.0)) for _ in range(8))

    def look_for_violations(self, networks: Networks) -> None:
        """Find what is seldom drawn by chance: the space samples on the wrong side of f, and suspects: points of far
        space where f is about to rise above zero, and points nearer to the surface where it is about to be wrong."""
        self._violations = self._violations_of(networks).cpu()
        points = self._floaters(networks, -LOW)[:SUSPECTS]
        excluded, distance = self._far.truth(points)
        found = excluded.any(axis=1)  # nor can the exact heights empty a hidden cavity
        self._add_suspects(0, points[found], excluded[found], distance[found])
        for side in range(2):
            points, f = self._doubtful(networks, side)
            excluded, distance = self._far.truth(points)
            found = (excluded.any(axis=1) == (side == 0)) & (distance > CLEAR)
            self._known[side] = np.concatenate([self._known[side], points[found]])[-KNOWN:]
            found &= f < SUSPECT
            self._add_suspects(side, points[found], excluded[found], distance[found])

    def _add_suspects(self, side: int, points: np.ndarray, excluded: np.ndarray, distance: np.ndarray) -> None:
        numbers = (self._suspects[side] + np.arange(len(points))) % SUSPECTS
        rows = self.n_space + side * SUSPECTS + numbers
        self._set_space(torch.from_numpy(rows), points, excluded, distance)
        self._suspects[side] += len(rows)

    def _violations_of(self, networks: Networks) -> torch.Tensor:
        nothing = torch.empty(0, dtype=torch.int64, device=self.device)

        def look(at: int) -> torch.Tensor:
            part = torch.arange(at, min(at + LOOK_AT_ONCE, self.n_space), device=self.device)
            with torch.no_grad():
                terms = self.terms(networks, nothing, part)
            return part[(terms.argument > self._margin[part]) & (terms.cost > 0)]

        return torch.cat(self._team.map(look, range(0, self.n_space, LOOK_AT_ONCE)))

    def _doubtful(self, networks: Networks, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Points outside (side 0) or inside (1) where f is wrong or nearly so, (N, 3), and f (N,), for the outside -f.

        Near jumps of the heights, networks leave specks of solid, or cut slits into it, that may be smaller than the
        samples lie apart. A sample at a distance d has a ball of that radius around it which is all on its side.
        """
        samples, depth = self._off[side]
        if not len(samples):
            return samples, depth
        at = self._hunter.integers(len(samples), size=HUNT_NEAR)
        away = self._hunter.normal(size=(HUNT_NEAR, 3))
        away *= ((depth[at] - CLEAR) * self._hunter.random(HUNT_NEAR) / np.linalg.norm(away, axis=1))[:, None]
        points = self._put(samples[at] + away)
        known = self._known[side]
        if len(known):
            near = known[self._hunter.integers(len(known), size=HUNT_NEAR // 4)]
            points = torch.cat([points, self._put(near + self._hunter.normal(size=near.shape) * AROUND)])

        def look(at: int) -> tuple[torch.Tensor, torch.Tensor]:
            part = points[at : at + LOOK_AT_ONCE]
            least = torch.full((len(part),), FAR, device=self.device)
            for k in range(len(networks)):
                least = torch.minimum(least, self._slack(networks, k, part))
            f = least if side else -least
            return part[f < LOW], f[f < LOW]

        with torch.no_grad():
            parts = zip(*self._team.map(look, range(0, len(points), LOOK_AT_ONCE)), strict=True)
        # The last are those around what was known.
        found, f = (torch.cat(part)[-SUSPECTS:].cpu().numpy() for part in parts)
        return found, f

    def _floaters(self, networks: Networks, level: float) -> np.ndarray:
        """(N, 3) points of far space where f is above a level."""
        points = self._put(self._far.draw(HUNT, self._hunter))

        def above(at: int) -> torch.Tensor:
            part = points[at : at + LOOK_AT_ONCE]
            for k in range(len(networks)):
                part = part[self._slack(networks, k, part) > level]
            return part

        with torch.no_grad():
            found = self._team.map(above, range(0, len(points), LOOK_AT_ONCE))
        return torch.cat([points[:0], *found]).cpu().numpy()

    def _slack(self, networks: Networks, k: int, points: torch.Tensor) -> torch.Tensor:
        """(N,): min(far - z, z - near) of DHF k at points (N, 3) of the normalised frame."""
        x = points @ self._rotations[k]
        fold(x, self._frames[k].mirrors)
        y = heights(networks, k, x[:, :2])
        return torch.minimum(y[:, 1] - x[:, 2], x[:, 2] - y[:, 0])

    def gradient(self, networks: Networks, surface: torch.Tensor, space: torch.Tensor) -> tuple[torch.Tensor, float]:
        """(K, P) gradient in theta of the loss, and the loss: the mean cost of the surface samples and that of the
        space samples with these indices, added."""
        if self.device.type != "cpu":
            theta = networks.theta.detach().requires_grad_()
            cost = self.terms(replace(networks, theta=theta), surface, space).cost
            loss = cost[: len(surface)].mean() + cost[len(surface) :].mean()
            return torch.autograd.grad(loss, theta)[0], loss.item()
        theta_array, boxes = networks.theta.detach().numpy(), self._boxes.numpy()
        on_surface = (self._surface.numpy(), self._seen.numpy(), self._cosine.numpy())
        in_space = tuple(t.numpy() for t in (self._space, self._excluded, self._inside, self._margin, self._weight))

        def shard(s: int) -> tuple[np.ndarray, float]:
            on, off = (i.numpy()[len(i) * s // SHARDS : len(i) * (s + 1) // SHARDS] for i in (surface, space))
            scales = (np.float32(1 / max(len(i), 1)) for i in (surface, space))
            return kernel.composite_gradient(
                theta_array, *networks.for_kernel, boxes, on_surface, in_space, on, off, *scales
            )

        gradients, losses = zip(*self._team.map(shard, range(SHARDS)), strict=True)
        return torch.from_numpy(sum(gradients[1:], start=gradients[0])), sum(losses)

    def terms(self, networks: Networks, surface: torch.Tensor, space: torch.Tensor) -> Terms:
        """Terms of the surface samples and then the space samples with these indices."""
        n = len(surface)
        slack, sides, uvs = [], [], []
        for k in range(len(networks)):
            x = torch.cat([self._surface[k][surface], self._space[k][space]])
            uv = torch.minimum(torch.maximum(x[:, :2], self._boxes[k, :2, 0]), self._boxes[k, :2, 1])
            y = heights(networks, k, uv)
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

    def _in_frames(self, points: np.ndarray) -> torch.Tensor:
        """(K, N, 3): points (N, 3) in the frame of every DHF, on the side of its mirrors that the network describes."""
        uvz = self._put(points) @ self._rotations
        for x, frame in zip(uvz, self._frames, strict=True):
            fold(x, frame.mirrors)
        return uvz

    def _put(self, array: object) -> torch.Tensor:
        return torch.as_tensor(array, dtype=torch.float32).to(self.device)
