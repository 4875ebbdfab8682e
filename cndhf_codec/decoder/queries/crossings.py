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

    def is_below(self, triangles: I64, points: F64, axis: int) -> Mask:
        """Whether points (N, 3) come before triangles (N,) on their lines along an axis; the lines meet them.

        Beyond the triangle's ends along the axis, that is certain; between them, the side of its plane decides.
        """
        a, b, c = (self.corners[3 * i : 3 * i + 3].take(triangles, axis=1) for i in range(3))
        heights = np.stack([a[axis], b[axis], c[axis]])
        at = points[:, axis]
        k, m = (axis + 1) % 3, (axis + 2) % 3
        e, f = b - a, c - a
        normal = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
        side = normal[axis] * (at - a[axis]) + normal[k] * (points[:, k] - a[k]) + normal[m] * (points[:, m] - a[m])
        before = np.where(normal[axis] < 0, side > 0, side < 0)
        return (at < heights.min(axis=0)) | (before & (at < heights.max(axis=0)))

    def heights(self, triangles: I64, u: F64, v: F64, axis: int) -> F64:
        """Where lines along an axis meet triangles (N,), as coordinates (N,); within the triangle's ends."""
        a, b, c = (self.corners[3 * i : 3 * i + 3].take(triangles, axis=1) for i in range(3))
        k, m = (axis + 1) % 3, (axis + 2) % 3
        e, f = b - a, c - a
        along = e[k] * f[m] - e[m] * f[k]
        du, dv = u - a[k], v - a[m]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            s, t = (du * f[m] - dv * f[k]) / along, (dv * e[k] - du * e[m]) / along
            height = a[axis] + s * e[axis] + t * f[axis]
        ends = np.stack([a[axis], b[axis], c[axis]])
        # NaN where the projection has no area: any height of the triangle will do.
        return np.fmin(np.fmax(height, ends.min(axis=0)), ends.max(axis=0))
