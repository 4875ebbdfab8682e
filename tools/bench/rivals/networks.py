"""What the rivals share: training, rounding to bytes, and the mesh of a network's zero level."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import torch
import zstandard
from skimage.measure import marching_cubes

from .samples import Samples

RESOLUTION = 256  # cells along the longest side of the volume, for the mesh
AT_ONCE = 2**16  # points evaluated at a time
ROUNDING_RATE = 0.1  # rate of the training with rounded weights, of the whole one's

Mesh = tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]


class Network(torch.nn.Module, ABC):
    """A network of the signed distance: `steps` of `batch` points with Adam, its rate a cosine from `rate` to zero."""

    steps: int
    batch = 4096
    rate = 1e-3

    @abstractmethod
    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) signed distances at points (N, 3)."""

    @abstractmethod
    def loss(self, points: torch.Tensor, distances: torch.Tensor, done: float) -> torch.Tensor:
        """Of a batch; done: share of the training that is over."""

    def covers(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) whether the network says anything at points (N, 3)."""
        return torch.ones(len(points), dtype=torch.bool)

    def whole(self) -> bytes:
        """What a file needs beside rounded weights."""
        return b""

    def settle(self) -> None:
        """Give up what a file cannot hold beside rounding."""

    def weights(self) -> list[torch.nn.Parameter]:
        """Those that are rounded."""
        return list(self.parameters())

    @property
    def size(self) -> int:
        return sum(p.numel() for p in self.parameters())


class Sines(torch.nn.Module):
    """A SIREN: `layers` sine layers of `width` neurons, then a linear one. Sitzmann et al. (2020), with their
    initialisation; omega goes into the first layer and into the hidden ones."""

    def __init__(self, width: int, layers: int, omega: float, hidden_omega: float = 30.0) -> None:
        super().__init__()
        sizes = [3] + layers * [width] + [1]
        self.linear = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in pairwise(sizes))
        self.omegas = [omega] + (layers - 1) * [hidden_omega]
        with torch.no_grad():
            for k, layer in enumerate(self.linear):
                bound = 1 / 3 if k == 0 else math.sqrt(6 / width) / hidden_omega
                layer.weight.uniform_(-bound, bound)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        for layer, omega in zip(self.linear, self.omegas, strict=False):
            x = torch.sin(omega * layer(x))
        return self.linear[-1](x)[:, 0]


def widest(parameters: int, count: int, layers: int) -> int:
    """The width of `count` SIRENs that have at most so many parameters together."""
    width = 1
    while count * ((layers - 1) * (width + 1) ** 2 + (layers + 4) * (width + 1) + 1) <= parameters:
        width += 1
    return width


def train(network: Network, samples: Samples, steps: int, seed: int, rounding: bool = False) -> None:
    """rounding: losses are those of rounded weights, and their gradients move the weights as they are."""
    torch.set_flush_denormal(True)  # far from the surface gradients are tiny: IDF's steps take five times as long
    # Switched off again below: fits of ours that follow are as in a process of their own.
    draw = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=network.rate * (ROUNDING_RATE if rounding else 1))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    kept = torch.nonzero(network.covers(samples.points))[:, 0]
    for step in range(steps):
        at = kept[torch.randint(len(kept), (network.batch,), generator=draw)]
        exact = [w.detach().clone() for w in network.weights()]
        if rounding:
            round_weights(network)
        optimiser.zero_grad()
        network.loss(samples.points[at], samples.distances[at], 1.0 if rounding else step / steps).backward()
        with torch.no_grad():
            for w, e in zip(network.weights(), exact, strict=True):
                w.copy_(e)
        optimiser.step()
        schedule.step()
    torch.set_flush_denormal(False)


def round_weights(network: Network) -> list[bytes]:
    """Round every tensor to 8 bits with one step, and return what a file has of each."""
    data = []
    with torch.no_grad():
        for tensor in network.weights():
            step = max(float(tensor.abs().max()), 1e-12) / 127
            whole = torch.round(tensor / step)
            tensor.copy_(whole * step)
            data.append(np.float32(step).tobytes() + whole.numpy().astype(np.int8).tobytes())
    return data


def rounded(network: Network, samples: Samples, steps: int, seed: int) -> tuple[Network, int]:
    """The network as it comes back from a file, and the bytes of the file: weights of 8 bits, and zstd.

    Rounding is trained for, a tenth of `steps`: without it, a SIREN of 4,801 weights needed 6,596 bytes to keep its
    loss within a tenth.
    """
    other = copy.deepcopy(network)
    other.settle()
    train(other, samples, max(1, steps // 10), seed, rounding=True)
    data = b"".join([other.whole(), *round_weights(other)])
    return other, len(zstandard.ZstdCompressor(19).compress(data))


def mesh_of(network: Network, samples: Samples, resolution: int = RESOLUTION) -> Mesh:
    """Marching cubes on a grid over the volume. Raises ValueError where the network has no zero level there."""
    low, high = samples.box
    spacing = float((high - low).max()) / resolution
    axes = [np.arange(a, b + spacing, spacing, dtype=np.float32) for a, b in zip(low, high, strict=True)]
    shape = tuple(len(a) for a in axes)
    y, z = np.meshgrid(axes[1], axes[2], indexing="ij")
    plane = np.stack([np.zeros_like(y), y, z], axis=-1).reshape(-1, 3)
    values, known = np.ones(shape, np.float32), np.zeros(shape, bool)
    for i, x in enumerate(axes[0]):
        plane[:, 0] = x
        points = torch.from_numpy(plane)
        inside = network.covers(points)
        out = torch.ones(len(points))
        if inside.any():
            out[inside] = torch.cat([network(p).detach() for p in points[inside].split(AT_ONCE)])
        values[i], known[i] = out.numpy().reshape(shape[1:]), inside.numpy().reshape(shape[1:])
    # Only cells all of whose corners are known: `marching_cubes` asks its mask at a cell's upper corner alone.
    cells = np.zeros_like(known)
    corners = [known[tuple(slice(o, n - 1 + o) for o, n in zip(at, shape, strict=True))] for at in np.ndindex(2, 2, 2)]
    cells[1:, 1:, 1:] = np.all(corners, axis=0)
    try:
        vertices, faces = marching_cubes(values, 0.0, spacing=3 * (spacing,), mask=cells)[:2]
    except RuntimeError as exc:  # none in these cells
        raise ValueError(str(exc)) from exc
    return vertices.astype(np.float64) + low, faces.astype(np.int64)
