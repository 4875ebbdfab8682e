"""Single triangles: their nearest points to points, and their hits by rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64
from .vectors import cross, dot

# A triangle whose height is less than this part of its longest side counts as its edges: rounding hides its normal.
THIN = 1e-12


class Feet(NamedTuple):
    """squared: (N,) squared distances. point: (3, N) nearest points."""

    squared: F64
    point: F64


class Hits(NamedTuple):
    """distance: (N,) along the rays; inf where they miss. normal: (3, N) of length one."""

    distance: F64
    normal: F64


class Triangles:
    """Triangles, prepared for points and rays."""

    def __init__(self, corners: F64) -> None:
        """corners: (3, 3, M), by corner and coordinate."""
        a, e, f = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        g = f - e
        n = cross(e, f)
        self._corners = corners
        squared = dot(n, n)
        longest = np.maximum(np.maximum(dot(e, e), dot(f, f)), dot(g, g))
        self._thin = squared <= (THIN * longest) ** 2
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # Vectors whose products with p - a are the foot's coordinates along e and f.
            along_e, along_f = cross(f, n), cross(n, e)
            rows = [a, e, f, along_e / squared, along_f / squared]
            rows += [s / dot(s, s) for s in (e, f, g)]
        # An edge without length has numbers that are not finite: 0 makes its first end the foot.
        self._rows = np.nan_to_num(np.concatenate(rows), copy=False, nan=0, posinf=0, neginf=0)

    def feet(self, triangles: I64, x: F64) -> Feet:
        """Nearest points of triangles (N,) to points x (3, N)."""
        a, e, f, along_e, along_f = self._rows[:15].take(triangles, axis=1).reshape(5, 3, -1)
        p = x - a
        v, w = dot(p, along_e), dot(p, along_f)
        within = (np.minimum(np.minimum(v, w), 1 - v - w) >= 0) & ~self._thin.take(triangles)
        off = np.flatnonzero(~within)
        v[off], w[off] = self._on_edges(triangles.take(off), *(s.take(off, axis=1) for s in (p, e, f)))
        p -= v * e
        p -= w * f
        # Once more, with what is left of p: in a thin triangle, v and w have lost digits. Feet stay in the triangle.
        at = np.flatnonzero(within)
        left = p.take(at, axis=1)
        more_v, more_w = dot(left, along_e.take(at, axis=1)), dot(left, along_f.take(at, axis=1))
        v, w = v.take(at) + more_v, w.take(at) + more_w
        still = np.minimum(np.minimum(v, w), 1 - v - w) >= 0
        left -= more_v * still * e.take(at, axis=1)
        left -= more_w * still * f.take(at, axis=1)
        p[:, at] = left
        return Feet(dot(p, p), x - p)

    def hits(self, triangles: I64, origins: F64, directions: F64, frame: F64) -> Hits:
        """Hits of triangles (N,) by rays (3, N) with unit directions (3, N).

        frame: (2, 3, N) two vectors across each ray. Seen along the ray, corners have two coordinates, which are the
        same for all triangles at a corner: no ray slips through between two triangles that share an edge.
        """
        corners = self._corners.take(triangles, axis=2)
        p = corners - origins
        along = [dot(p[i], directions) for i in range(3)]
        u = [dot(p[i], frame[0]) for i in range(3)]
        v = [dot(p[i], frame[1]) for i in range(3)]
        # Twice the areas of the triangles that the ray makes with the edges opposite to each corner.
        areas = [u[j] * v[k] - u[k] * v[j] for j, k in ((1, 2), (2, 0), (0, 1))]
        total = areas[0] + areas[1] + areas[2]
        least = np.minimum(np.minimum(areas[0], areas[1]), areas[2])
        greatest = np.maximum(np.maximum(areas[0], areas[1]), areas[2])
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (areas[0] * along[0] + areas[1] * along[1] + areas[2] * along[2]) / total
        hit = ((least >= 0) | (greatest <= 0)) & (total != 0) & (distance >= 0)
        n = cross(corners[1] - corners[0], corners[2] - corners[0])
        length = np.sqrt(dot(n, n))
        hit &= length > 0
        return Hits(np.where(hit, distance, np.inf), n / np.where(length > 0, length, 1))

    def _on_edges(self, triangles: I64, p: F64, e: F64, f: F64) -> tuple[F64, F64]:
        """Coordinates along e and f, (N,) each, of the edges' nearest points to a + p."""
        over_e, over_f, over_g = self._rows[15:].take(triangles, axis=1).reshape(3, 3, -1)
        best_v = np.clip(dot(p, over_e), 0, 1)
        best_w = np.zeros_like(best_v)
        rest = p - best_v * e
        best = dot(rest, rest)
        w = np.clip(dot(p, over_f), 0, 1)
        rest = p - w * f
        squared = dot(rest, rest)
        nearer = squared < best
        np.copyto(best_v, 0, where=nearer)
        np.copyto(best_w, w, where=nearer)
        np.copyto(best, squared, where=nearer)
        w = np.clip(dot(p - e, over_g), 0, 1)
        rest = p - (1 - w) * e
        rest -= w * f
        nearer = dot(rest, rest) < best
        np.copyto(best_v, 1 - w, where=nearer)
        np.copyto(best_w, w, where=nearer)
        return best_v, best_w
