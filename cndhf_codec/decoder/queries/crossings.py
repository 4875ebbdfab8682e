"""Signed crossings of triangles by lines along an axis, with ties broken the same way for all triangles.

A line along an axis meets a triangle where the line's foot lies in the triangle's projection along that axis. The
projection counts with a winding number: the sum, over its three edges, of the crossings of the half-line from the foot
along the next axis. An edge is always computed from the same end, so two triangles that share it add equal numbers
with opposite signs. What lines cross in a closed mesh therefore adds up to zero, whatever was rounded: no line slips
through between two triangles, nor meets both.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...arrays import F64, I64, Mask

I8 = npt.NDArray[np.int8]


class CrossingTriangles:
    """Triangles, prepared for crossings by lines along the axes."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        # Corners in one order of all positions, not of all vertices: seams of doubled vertices are then closed, too.
        rank = np.empty(len(vertices), np.int64)
        rank[np.lexsort(vertices.T)] = np.arange(len(vertices))
        r = rank[faces]
        order = np.argsort(r, axis=1)
        even = (r[:, 0] < r[:, 1]).astype(np.int8) + (r[:, 1] < r[:, 2]) + (r[:, 2] < r[:, 0]) == 2
        self.sign = np.where(even, np.int8(1), np.int8(-1))
        # Row 3 i + k: coordinate k of corner i.
        self.corners = np.ascontiguousarray(vertices[np.take_along_axis(faces, order, axis=1)].reshape(-1, 9).T)

    def covers(self, triangles: I64, u: F64, v: F64, axis: int) -> I8:
        """Winding numbers (N,) of projected triangles (N,) around feet (u, v), each (N,).

        u, v: coordinates of the foot along the next axis and the one after it, cyclically. 1 where a line along the
        axis leaves the triangle on the side of its normal, -1 where it enters, 0 where it misses.
        """
        a, b = (axis + 1) % 3, (axis + 2) % 3
        pu, pv, below = [], [], []
        for corner in range(3):
            pu.append(self.corners[3 * corner + a].take(triangles))
            pv.append(self.corners[3 * corner + b].take(triangles))
            below.append(pv[-1] <= v)
        total = np.zeros(len(triangles), np.int8)
        for i, j, sign in ((0, 1, 1), (1, 2, 1), (0, 2, -1)):
            left = (pu[j] - pu[i]) * (v - pv[i]) - (pv[j] - pv[i]) * (u - pu[i])
            up = below[i] & ~below[j] & (left > 0)
            down = below[j] & ~below[i] & (left < 0)
            step = up.view(np.int8) - down.view(np.int8)
            if sign > 0:
                total += step
            else:
                total -= step
        total *= self.sign.take(triangles)
        return total

    def between(self, triangles: I64, points: F64, ends: F64, axis: int) -> Mask:
        """Whether triangles (N,) are met on the way along an axis from points (3, N) to `ends` (N,), coordinates there.

        The whole line is known to meet the triangle. Beyond the triangle's ends along the axis, it is certain which
        side a place is on; between them, the side of the plane decides.
        """
        (a, b, c), normal = self._planes(triangles)
        lowest = np.minimum(np.minimum(a[axis], b[axis]), c[axis])
        highest = np.maximum(np.maximum(a[axis], b[axis]), c[axis])
        k, m = (axis + 1) % 3, (axis + 2) % 3
        across = normal[k] * (points[k] - a[k]) + normal[m] * (points[m] - a[m])
        flip = normal[axis] < 0

        def below(x: F64) -> Mask:
            side = across + normal[axis] * (x - a[axis])
            return (x < lowest) | ((x < highest) & ((side < 0) ^ flip))

        return below(points[axis]) != below(ends)

    def heights(self, triangles: I64, u: F64, v: F64, axis: int) -> F64:
        """Where lines along an axis meet triangles (N,), as coordinates (N,); within the triangle's ends."""
        (a, b, c), normal = self._planes(triangles)
        k, m = (axis + 1) % 3, (axis + 2) % 3
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            height = a[axis] - (normal[k] * (u - a[k]) + normal[m] * (v - a[m])) / normal[axis]
        lowest = np.minimum(np.minimum(a[axis], b[axis]), c[axis])
        highest = np.maximum(np.maximum(a[axis], b[axis]), c[axis])
        # NaN where the projection has no area: any height of the triangle will do.
        return np.fmin(np.fmax(height, lowest), highest)

    def _planes(self, triangles: I64) -> tuple[F64, list[F64]]:
        """Corners (3, 3, N), by corner and coordinate, and normals, 3 arrays (N,), of any length."""
        corners = self.corners.take(triangles, axis=1).reshape(3, 3, -1)
        e, f = corners[1] - corners[0], corners[2] - corners[0]
        return corners, [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
