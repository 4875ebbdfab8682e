"""Nearest points of single triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64


class Feet(NamedTuple):
    """squared: (N,) squared distances. point: (3, N) nearest points."""

    squared: F64
    point: F64


class NearTriangles:
    """Triangles, prepared for the nearest points of each."""

    def __init__(self, corners: F64) -> None:
        """corners: (3, 3, M), by corner and coordinate."""
        a, e, f = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        g = f - e
        n = np.stack([e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]])
        squared = (n**2).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # Vectors whose products with p - a are the foot's coordinates along e and f.
            along_e = np.stack([f[1] * n[2] - f[2] * n[1], f[2] * n[0] - f[0] * n[2], f[0] * n[1] - f[1] * n[0]])
            along_f = np.stack([n[1] * e[2] - n[2] * e[1], n[2] * e[0] - n[0] * e[2], n[0] * e[1] - n[1] * e[0]])
            rows = [a, e, f, along_e / squared, along_f / squared]
            rows += [s / (s**2).sum(axis=0) for s in (e, f, g)]
        # A triangle or an edge without length has numbers that are not finite: 0 makes its first corner the foot.
        self.rows = np.nan_to_num(np.concatenate(rows), copy=False, nan=0, posinf=0, neginf=0)

    def feet(self, triangles: I64, x: F64) -> Feet:
        """Nearest points of triangles (N,) to points x (3, N).

        Every candidate is a point of the triangle, so that a thin triangle's rounding can make a distance too great by
        no more than itself, and never too small.
        """
        a, e, f, along_e, along_f = self.rows[:15].take(triangles, axis=1).reshape(5, 3, -1)
        p = x - a
        v, w = _dot(p, along_e), _dot(p, along_f)
        off = np.flatnonzero(np.minimum(np.minimum(v, w), 1 - v - w) < 0)
        if len(off):
            v[off], w[off] = self._on_edges(triangles.take(off), p.take(off, axis=1), e.take(off, axis=1), f.take(off, axis=1))
        p -= v * e
        p -= w * f
        return Feet(_dot(p, p), x - p)

    def _on_edges(self, triangles: I64, p: F64, e: F64, f: F64) -> tuple[F64, F64]:
        """Coordinates along e and f, (N,) each, of the edges' nearest points to a + p."""
        over_e, over_f, over_g = self.rows[15:].take(triangles, axis=1).reshape(3, 3, -1)
        best_v = np.clip(_dot(p, over_e), 0, 1)
        best_w = np.zeros_like(best_v)
        rest = p - best_v * e
        best = _dot(rest, rest)
        w = np.clip(_dot(p, over_f), 0, 1)
        rest = p - w * f
        squared = _dot(rest, rest)
        nearer = squared < best
        np.copyto(best_v, 0, where=nearer)
        np.copyto(best_w, w, where=nearer)
        np.copyto(best, squared, where=nearer)
        w = np.clip(_dot(p - e, over_g), 0, 1)
        rest = p - (1 - w) * e
        rest -= w * f
        nearer = _dot(rest, rest) < best
        np.copyto(best_v, 1 - w, where=nearer)
        np.copyto(best_w, w, where=nearer)
        return best_v, best_w


def _dot(a: F64, b: F64) -> F64:
    """Scalar products (N,) of vectors (3, N)."""
    out = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out
