"""One double height field: its heights over a plane, and its part of the implicit function f.

f is positive inside the solid, zero on its surface and negative outside. The f of a solid is the least of its fields'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...arrays import F32
from ...format import DhfRecord
from ...format.container import fold
from ..parallel import matmul
from .network import Network

Heights = Callable[[F32, F32], tuple[F32, F32]]  # u, v (N,) -> near, far (N,)

# Heights and f, evaluated in float32 in two ways, differ by less than this (normalised units): ten times what was seen.
FLOAT32_ERROR = 1e-5

# f is the least of eight terms: far - z, z - near, and the distances to the six planes of the domain box. These are
# the terms' gradients by (u, v, z); for the first two, of heights without slope.
FAR_TERM, NEAR_TERM = 0, 1
TERM_GRADIENTS = np.vstack([[0, 0, -1], [0, 0, 1], np.eye(3), -np.eye(3)]).astype(np.float32)


class Dhf:
    """A decoded DHF. Its own frame is (u, v, z) = R p for points p of the normalised frame."""

    def __init__(self, record: DhfRecord) -> None:
        self.record = record
        self.rotation = record.rotation.astype(np.float32)
        self.bounds = record.bounds.astype(np.float32)
        self.mirrors = record.mirrors
        self.network = Network(record.weights(), record.omega_first, record.omega_hidden)

    def heights(self, uv: F32) -> F32:
        """(N, 2) float32 -> (N, 2): near and far height; (u, v) outside the domain box is clamped to it."""
        return self.network(self._network_input(uv))

    def _network_input(self, uv: F32) -> F32:
        """(N, 2) -> (N, 2): clamped to the domain and, in a mirrored field, moved to the half that is stored."""
        uv = np.clip(uv, self.bounds[:2, 0], self.bounds[:2, 1])
        fold(uv, self.mirrors)
        return uv

    def implicit(self, points: F32, heights: Heights | None = None) -> F32:
        """(N, 3) float32 points of the normalised frame -> (N,) f of this DHF.

        `heights` replaces the exact network where a height table is good enough.
        """
        u, v, z = uvz = matmul(self.rotation, points.T)
        near, far = heights(u, v) if heights else self.heights(uvz[:2].T).T
        bottom, top = self.bounds[2]
        f = np.minimum(far, top)
        f -= z
        other = np.maximum(near, bottom)
        np.minimum(f, np.subtract(z, other, out=other), out=f)
        for x, (lo, hi) in zip((u, v), self.bounds[:2], strict=True):
            np.minimum(f, np.subtract(x, lo, out=other), out=f)
            np.minimum(f, np.subtract(hi, x, out=other), out=f)
        return f

    def implicit_gradient(self, points: F32) -> tuple[F32, F32]:
        """(N, 3) float32 points of the normalised frame -> `implicit` (N,) and its gradient (N, 3) there.

        Where two terms of f are equal, the gradient is that of one of them.
        """
        uvz = matmul(self.rotation, points.T).T
        lo, hi = self.bounds[:2, 0], self.bounds[:2, 1]
        heights, slopes = self.network.gradient(self._network_input(uvz[:, :2]))
        for k, middle in enumerate(self.mirrors):
            if middle is not None:
                slopes[uvz[:, k] < middle, :, k] *= -1
        # Outside the domain the heights are constant: those of the nearest point of its edge.
        slopes *= ((uvz[:, :2] >= lo) & (uvz[:, :2] <= hi))[:, None, :]
        z = uvz[:, 2]
        terms = np.stack(
            [heights[:, 1] - z, z - heights[:, 0], *(uvz - self.bounds[:, 0]).T, *(self.bounds[:, 1] - uvz).T]
        )
        least = terms.argmin(axis=0)
        gradient = TERM_GRADIENTS[least]
        for term, k in ((FAR_TERM, 1), (NEAR_TERM, 0)):
            rows = np.flatnonzero(least == term)
            gradient[rows, :2] = slopes[rows, k] if term == FAR_TERM else -slopes[rows, k]
        return terms[least, np.arange(len(points))], matmul(self.rotation.T, gradient.T).T


def implicit(dhfs: Sequence[Dhf], points: F32) -> F32:
    """f (N,) at points (N, 3) of the normalised frame, from the exact networks."""
    return np.minimum.reduce([dhf.implicit(points) for dhf in dhfs])


def implicit_gradient(dhfs: Sequence[Dhf], points: F32) -> tuple[F32, F32]:
    """f (N,) and its gradient (N, 3) at points (N, 3) of the normalised frame, from the exact networks."""
    if len(dhfs) == 1:
        return dhfs[0].implicit_gradient(points)
    owner = np.argmin([dhf.implicit(points) for dhf in dhfs], axis=0)
    f, gradient = np.empty(len(points), dtype=np.float32), np.empty((len(points), 3), dtype=np.float32)
    for k, dhf in enumerate(dhfs):
        rows = np.flatnonzero(owner == k)
        f[rows], gradient[rows] = dhf.implicit_gradient(points[rows])
    return f, gradient
