"""One double height field: heights over its plane, and its part of the implicit function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..format import DhfRecord
from .network import F32, Network

Heights = Callable[[F32], F32]


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
        near, far = (heights or self.heights)(uvz[:, :2]).T
        z = uvz[:, 2]
        f = np.minimum(far - z, z - near)
        for k in range(3):
            lo, hi = self.bounds[k]
            np.minimum(f, uvz[:, k] - lo, out=f)
            np.minimum(f, hi - uvz[:, k], out=f)
        return f
