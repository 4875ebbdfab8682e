"""Nearest points of a triangle mesh, for many points at once, on all threads.

The fit asks for them some hundred times, each time of another tessellation: a third of its time. A tree of boxes is
made in a few milliseconds, by splitting the faces in halves along the longest side of their centres' box. Points are
taken in blocks; each begins with the face that the one before it was nearest to, which spares most of the search where
neighbours follow each other. Blocks are of one size whatever the number of threads, so that where two faces are equally
near, the one that is taken does not depend on it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from ...arrays import F64, I64

# Evidence for these constants: ADR 036.
BLOCK = 256  # points of a block
# Of the squared sine between two sides: products of coordinates are no better than this, and a triangle that is so thin
# differs from its longest side by less than a millionth of its length.
FLAT = 1e-12


class Closest(NamedTuple):
    """distances: (N,). faces: (N,) the face of each nearest point. points: (N, 3)."""

    distances: F64
    faces: I64
    points: F64


class Tree:
    """A triangle mesh of at least one face, ready for nearest points. order: of its faces in the tree, where they have
    been sorted already, for vertices that lie about so."""

    def __init__(self, vertices: F64, faces: I64, order: I64 | None = None) -> None:
        self.vertices, self.faces = vertices, faces
        self.order = _split(vertices, faces) if order is None else order
        self._corners = _gathered(vertices, faces, self.order)
        self._boxes = _boxes(self._corners)

    def closest(self, points: F64) -> Closest:
        """The nearest point of the surface to each of points (N, 3)."""
        squared, at, nearest = _nearest(self._corners, self._boxes, points)
        return Closest(np.sqrt(squared), self.order[at], nearest)


@nb.njit(cache=True, parallel=True)
def _split(vertices: F64, faces: I64) -> I64:
    """An order of faces in which each node of the tree has a half of the faces of its parent: those whose centres come
    first along the longest side of the centres' box."""
    points = np.empty((len(faces), 3))
    for f in nb.prange(len(faces)):
        for k in range(3):
            points[f, k] = vertices[faces[f, 0], k] + vertices[faces[f, 1], k] + vertices[faces[f, 2], k]
    n = len(points)
    order = np.arange(n)
    key = np.empty(n)
    size = 1
    while size < n:
        size *= 2
    # The first of two children is full: it has half of the leaves of its node.
    while size > 1:
        half = size // 2
        for node in nb.prange((n + size - 1) // size):
            begin, end = node * size, min((node + 1) * size, n)
            if begin + half >= end:
                continue
            best, axis = -1.0, 0
            for k in range(3):
                least = greatest = points[order[begin], k]
                for i in range(begin + 1, end):
                    x = points[order[i], k]
                    least, greatest = min(least, x), max(greatest, x)
                if greatest - least > best:
                    best, axis = greatest - least, k
            for i in range(begin, end):
                key[i] = points[order[i], axis]
            _select(key, order, begin, end - 1, begin + half)
        size = half
    return order


@nb.njit(cache=True)
def _select(key: F64, order: I64, low: int, high: int, middle: int) -> None:
    """Sort keys low to high so far that those before middle are no larger than those from there (Hoare's find)."""
    while low < high:
        pivot = key[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while key[i] < pivot:
                i += 1
            while pivot < key[j]:
                j -= 1
            if i <= j:
                key[i], key[j] = key[j], key[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@nb.njit(cache=True, parallel=True)
def _gathered(vertices: F64, faces: I64, order: I64) -> F64:
    """(M, 3, 3) the corners of faces, in an order."""
    corners = np.empty((len(order), 3, 3))
    for i in nb.prange(len(order)):
        for c in range(3):
            for k in range(3):
                corners[i, c, k] = vertices[faces[order[i], c], k]
    return corners


@nb.njit(cache=True, parallel=True)
def _boxes(corners: F64) -> F64:
    """(2 P, 6) boxes, least corners and greatest: that of node i holds those of 2 i and 2 i + 1; the leaves are the
    last P. Those without faces are turned inside out, and infinitely far away."""
    first = 1
    while first < len(corners):
        first *= 2
    boxes = np.empty((2 * first, 6))
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf
    for f in nb.prange(len(corners)):
        for k in range(3):
            a, b, c = corners[f, 0, k], corners[f, 1, k], corners[f, 2, k]
            boxes[first + f, k] = min(a, b, c)
            boxes[first + f, 3 + k] = max(a, b, c)
    for i in range(first - 1, 0, -1):
        for k in range(3):
            boxes[i, k] = min(boxes[2 * i, k], boxes[2 * i + 1, k])
            boxes[i, 3 + k] = max(boxes[2 * i, 3 + k], boxes[2 * i + 1, 3 + k])
    return boxes


@nb.njit(cache=True, inline="always")
def _to_box(boxes: F64, i: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point to a box."""
    u = max(boxes[i, 0] - x, 0.0, x - boxes[i, 3])
    v = max(boxes[i, 1] - y, 0.0, y - boxes[i, 4])
    w = max(boxes[i, 2] - z, 0.0, z - boxes[i, 5])
    return u * u + v * v + w * w


@nb.njit(cache=True)
def _to_face(corners: F64, f: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Squared distance of a point to a triangle, and the nearest point (Ericson, 2005, section 5.1.5)."""
    ax, ay, az = corners[f, 0, 0], corners[f, 0, 1], corners[f, 0, 2]
    ux, uy, uz = corners[f, 1, 0] - ax, corners[f, 1, 1] - ay, corners[f, 1, 2] - az
    vx, vy, vz = corners[f, 2, 0] - ax, corners[f, 2, 1] - ay, corners[f, 2, 2] - az
    wx, wy, wz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    # The nearest point is a + s u + t v.
    if uu * vv - uv * uv <= FLAT * uu * vv:
        s, t = _on_needle(uu, uv, vv, d1, d2)
        return _offset(ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz, x, y, z)
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if d1 <= 0 and d2 <= 0:
        s, t = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        s, t = d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        s, t = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1 - t
    else:
        total = va + vb + vc
        s, t = vb / total, vc / total
    return _offset(ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz, x, y, z)


@nb.njit(cache=True)
def _offset(px: float, py: float, pz: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    dx, dy, dz = x - px, y - py, z - pz
    return dx * dx + dy * dy + dz * dz, px, py, pz


@nb.njit(cache=True)
def _on_needle(uu: float, uv: float, vv: float, wu: float, wv: float) -> tuple[float, float]:
    """s and t of the nearest point of a triangle without area: it lies on a side, any of which may be a point."""
    best, s, t = np.inf, 0.0, 0.0
    ee = uu - 2 * uv + vv
    for side in range(3):
        if side == 0:
            x, y = _share(wu, uu), 0.0
        elif side == 1:
            x, y = 0.0, _share(wv, vv)
        else:
            y = _share(wv - wu - uv + uu, ee)
            x = 1 - y
        # Squared distance, less that of the first corner.
        far = x * x * uu + 2 * x * y * uv + y * y * vv - 2 * x * wu - 2 * y * wv
        if far < best:
            best, s, t = far, x, y
    return s, t


@nb.njit(cache=True)
def _share(along: float, whole: float) -> float:
    return min(max(along / whole, 0.0), 1.0) if whole > 0 else 0.0


@nb.njit(cache=True, parallel=True)
def _nearest(corners: F64, boxes: F64, points: F64) -> tuple[F64, I64, F64]:
    n, first = len(points), len(boxes) // 2
    squared, at, nearest = np.empty(n), np.empty(n, dtype=np.int64), np.empty((n, 3))
    for block in nb.prange((n + BLOCK - 1) // BLOCK):
        stack, far = np.empty(64, dtype=np.int64), np.empty(64)
        face = 0
        for i in range(block * BLOCK, min(n, (block + 1) * BLOCK)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            best, px, py, pz = _to_face(corners, face, x, y, z)
            stack[0], far[0], depth = 1, 0.0, 1
            while depth > 0:
                depth -= 1
                if far[depth] >= best:
                    continue
                node = stack[depth]
                while node < first:
                    one, other = 2 * node, 2 * node + 1
                    d, e = _to_box(boxes, one, x, y, z), _to_box(boxes, other, x, y, z)
                    if e < d:
                        one, other, d, e = other, one, e, d
                    if e < best:
                        stack[depth], far[depth] = other, e
                        depth += 1
                    if d >= best:
                        node = 0
                        break
                    node = one
                if node == 0:
                    continue
                d, qx, qy, qz = _to_face(corners, node - first, x, y, z)
                if d < best:
                    best, px, py, pz, face = d, qx, qy, qz, node - first
            squared[i], at[i] = best, face
            nearest[i, 0], nearest[i, 1], nearest[i, 2] = px, py, pz
    return squared, at, nearest
