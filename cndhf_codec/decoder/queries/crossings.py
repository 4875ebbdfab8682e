"""Signed crossings of triangles by lines along an axis, with ties broken the same way for all triangles.

A line along an axis meets a triangle where the line's foot lies in the triangle's projection along that axis. The
projection counts with a winding number: the sum, over its three edges, of the crossings of the half-line from the foot
along the next axis. An edge is always computed from the same end, so two triangles that share it add equal numbers
with opposite signs. What lines cross in a closed mesh therefore adds up to zero, whatever was rounded: no line slips
through between two triangles, nor meets both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F64, I64, Mask

I8 = npt.NDArray[np.int8]
# The axis after each, and the one after that; for many, much faster than a remainder.
AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
Axis = int | I64


class Way(NamedTuple):
    """Ways along an axis: their feet, coordinates of their starts and ends along it, (N,) each."""

    u: F64
    v: F64
    start: F64
    end: F64


class Planes(NamedTuple):
    """Of triangles, seen along an axis: the first corner's coordinate, the least and the greatest; normals (N,) along
    the axis; and products (N,) of the normals' other parts with the ways from the first corners to the feet."""

    heights: F64
    lowest: F64
    highest: F64
    normal: F64
    across: F64


class CrossingTriangles:
    """Triangles, prepared for crossings by lines along the axes."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        # Corners in one order of all positions, not of all vertices: seams of doubled vertices are then closed, too.
        rank = np.empty(len(vertices), np.int64)
        rank[np.lexsort(vertices.T)] = np.arange(len(vertices))
        r = rank[faces]
        order = np.argsort(r, axis=1)
        even = (r[:, 0] < r[:, 1]).astype(np.int8) + (r[:, 1] < r[:, 2]) + (r[:, 2] < r[:, 0]) == 2
        self._sign = np.where(even, np.int8(1), np.int8(-1))
        # By corner, coordinate and triangle.
        self._corners = vertices[np.take_along_axis(faces, order, axis=1)].transpose(1, 2, 0).ravel()

    def covers(self, triangles: I64, u: F64, v: F64, axis: Axis) -> I8:
        """Winding numbers (N,) of projected triangles (N,) around feet (u, v), each (N,).

        u, v: coordinates of the foot along the next axis and the one after it, cyclically. 1 where a line along the
        axis leaves the triangle on the side of its normal, -1 where it enters, 0 where it misses. axis: one for all,
        or (N,).
        """
        pu, pv = (self._coordinates(triangles, after.take(axis)) for after in AFTER)
        below = [x <= v for x in pv]
        total = np.zeros(len(triangles), np.int8)
        for i, j, sign in ((0, 1, 1), (1, 2, 1), (0, 2, -1)):
            left = (pu[j] - pu[i]) * (v - pv[i])
            left -= (pv[j] - pv[i]) * (u - pu[i])
            up = below[i] & ~below[j] & (left > 0)
            down = below[j] & ~below[i] & (left < 0)
            step = up.view(np.int8) - down.view(np.int8)
            if sign > 0:
                total += step
            else:
                total -= step
        total *= self._sign.take(triangles)
        return total

    def between(self, triangles: I64, way: Way, axis: Axis) -> Mask:
        """Whether triangles (N,) are met on a way along an axis; the whole line is known to meet them.

        Beyond the triangle's ends along the axis, it is certain which side a place is on; between them, the side of the
        plane decides.
        """
        heights, lowest, highest, normal, across = self._planes(triangles, way.u, way.v, axis)
        flip = normal < 0

        def below(x: F64) -> Mask:
            side = across + normal * (x - heights)
            return (x < lowest) | ((x < highest) & ((side < 0) ^ flip))

        return below(way.start) != below(way.end)

    def heights(self, triangles: I64, u: F64, v: F64, axis: Axis) -> F64:
        """Where lines along an axis meet triangles (N,), as coordinates (N,); within the triangle's ends."""
        heights, lowest, highest, normal, across = self._planes(triangles, u, v, axis)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            height = heights - across / normal
        # NaN where the projection has no area: any height of the triangle will do.
        return np.fmin(np.fmax(height, lowest), highest)

    def _coordinates(self, triangles: I64, axis: Axis) -> list[F64]:
        """One coordinate (N,) of each of the three corners."""
        n = len(self._sign)
        at = triangles + axis * n
        return [self._corners[3 * n * corner :].take(at) for corner in range(3)]

    def _planes(self, triangles: I64, u: F64, v: F64, axis: Axis) -> Planes:
        pz, pu, pv = (self._coordinates(triangles, x) for x in (axis, *(after.take(axis) for after in AFTER)))
        eu, ev, ez = pu[1] - pu[0], pv[1] - pv[0], pz[1] - pz[0]
        fu, fv, fz = pu[2] - pu[0], pv[2] - pv[0], pz[2] - pz[0]
        across = (ev * fz - ez * fv) * (u - pu[0]) + (ez * fu - eu * fz) * (v - pv[0])
        lowest, highest = np.minimum(np.minimum(*pz[:2]), pz[2]), np.maximum(np.maximum(*pz[:2]), pz[2])
        return Planes(pz[0], lowest, highest, eu * fv - ev * fu, across)
