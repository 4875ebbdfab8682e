"""Products of vectors that are stored by coordinate: numpy is slow along axes as short as 3."""

from __future__ import annotations

import numpy as np

from ...arrays import F64


def dot(a: F64, b: F64) -> F64:
    """Scalar products (N,) of vectors (3, N)."""
    out = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out


def cross(a: F64, b: F64) -> F64:
    """Cross products (3, N) of vectors (3, N)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
