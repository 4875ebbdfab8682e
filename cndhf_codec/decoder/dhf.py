"""One double height field: heights over its plane, and its part of the implicit function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..format import DhfRecord
from .network import F32, Network

Heights = Callable[[F32], F32]

# The terms of the implicit function in their order, and their gradients by (u, v, z) with flat heights.
FAR, NEAR = 0, 1
TERM_GRADIENTS = np.vstack([[0, 0, -1], [0, 0, 1], np.eye(3), -np.eye(3)]).astype(np.float32)


class Dhf:
    """A decoded DHF. Coordinates are its own frame: (u, v, z) = R p, p in the normalised frame."""

    def __init__(self, record: DhfRecord) -> None:
        self.record = record
        self.rotation = record.rotation.astype(np.float32)
        self.bounds = record.bounds.astype(np.float32)
        self.network = Network(record.weights(), record.omega_first, record.omega_hidden)

    def heights(self, uv: F32) -> F32:
        """(N, 2) float32 -> (N, 2): near and far height; (u, v) outside the domain box is clamped to it."""
        return self.network(np.clip(uv, self.bounds[:2, 0], self.bounds[:2, 1]))

    def implicit(self, points: F32, heights: Heights | None = None) -> F32:
        """(N, 3) float32 points of the normalised frame -> (N,): positive inside this DHF.

        min(far - z, z - near) and the distances to the six planes of the domain box, whichever is least.
        `heights` stands in for the exact network where a table will do.
        """
        uvz = points @ self.rotation.T
        return self._terms(uvz, (heights or self.heights)(uvz[:, :2])).min(axis=0)

    def implicit_gradient(self, points: F32) -> tuple[F32, F32]:
        """(N, 3) float32 points of the normalised frame -> `implicit` (N,) and its gradient (N, 3) there.

        Where two terms of the least are equal, the gradient is that of one of them.
        """
        uvz = points @ self.rotation.T
        lo, hi = self.bounds[:2, 0], self.bounds[:2, 1]
        heights, slopes = self.network.gradient(np.clip(uvz[:, :2], lo, hi))
        # Beyond the box the heights go on as they are at its edge.
        slopes *= ((uvz[:, :2] >= lo) & (uvz[:, :2] <= hi))[:, None, :]
        terms = self._terms(uvz, heights)
        least = terms.argmin(axis=0)
        gradient = TERM_GRADIENTS[least]
        for term, k in ((FAR, 1), (NEAR, 0)):
            rows = np.flatnonzero(least == term)
            gradient[rows, :2] = slopes[rows, k] if term == FAR else -slopes[rows, k]
        return terms[least, np.arange(len(points))], gradient @ self.rotation

    def _terms(self, uvz: F32, heights: F32) -> F32:
        """(8, N): what f is the least of."""
        terms = np.empty((8, len(uvz)), dtype=np.float32)
        terms[FAR] = heights[:, 1] - uvz[:, 2]
        terms[NEAR] = uvz[:, 2] - heights[:, 0]
        terms[2:5] = (uvz - self.bounds[:, 0]).T
        terms[5:8] = (self.bounds[:, 1] - uvz).T
        return terms
