"""Simplify a mesh by edge collapses, cheapest first, measured by quadrics.

Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics" (1997): a vertex carries the sum of squared
distances from the planes of the faces that it stands for, weighted by their areas, and a collapse puts the new vertex
where the sum for both is least. Boundaries have planes of their own, across their faces. A collapse that would turn a
face over is refused. Topology may change, for small holes and handles cost more than they are worth in a small file:
so the result has to be cut (`cut.py`).
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numba as nb
import numpy as np

from ...arrays import F64, I64, Mask

# Evidence for these constants: ADR 036.
# A boundary edge of length l counts as a strip of width l: as much as the squares on its two sides would.
BOUNDARY_WEIGHT = 1.0
# Part of the quadric that holds a vertex where it is: it decides only where planes do not, in flat places.
HOLD = 1e-6
MOST_NEIGHBOURS = 1000
LEAST_COSINE = 0.2  # a face may turn by up to 78 degrees in one collapse; beyond it would soon fold over


class Simplified(NamedTuple):
    """vertices: (V, 3). faces: (F, 3), none with a vertex twice; not always a two-manifold."""

    vertices: F64
    faces: I64


class Simplifier:
    """Simplifies a mesh to fewer and fewer faces; each call goes on where the last has stopped."""

    def __init__(self, state: _State) -> None:
        self._state = state

    @classmethod
    def of(cls, vertices: F64, faces: I64) -> Simplifier:
        """Start with a mesh. vertices: (N, 3). faces: (M, 3), none with a vertex twice."""
        return cls(_start(np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces)))

    @property
    def n_faces(self) -> int:
        return int(self._state.n_alive[0])

    def copy(self) -> Simplifier:
        """One that goes on from here while this one stays."""
        return Simplifier(_copied(self._state))

    def to(self, n_faces: int) -> Simplified:
        """Simplify to at most `n_faces` faces, or as far as topology allows."""
        _collapse(self._state, n_faces)
        s = self._state
        kept = s.faces[s.alive]
        used, numbers = np.unique(kept, return_inverse=True)
        return Simplified(s.vertices[used], numbers.reshape(-1, 3).astype(np.int64))


class _State(NamedTuple):
    """The mesh while it is simplified. Corner 3 f + k is corner k of face f; the corners of a vertex form a list."""

    vertices: F64
    faces: I64  # (M, 3)
    alive: Mask  # (M,)
    first: I64  # (N,) first corner of a vertex, -1 at the end
    after: I64  # (3 M,) the next corner of the same vertex
    quadrics: F64  # (N, 10): xx xy xz yy yz zz x y z 1
    stamps: I64  # (N,) how often a vertex has changed
    n_alive: I64  # (1,) how many faces are alive


@nb.njit(cache=True)
def _copied(s: _State) -> _State:
    return _State(
        s.vertices.copy(),
        s.faces.copy(),
        s.alive.copy(),
        s.first.copy(),
        s.after.copy(),
        s.quadrics.copy(),
        s.stamps.copy(),
        s.n_alive.copy(),
    )


@nb.njit(cache=True)
def _start(vertices: F64, faces: I64) -> _State:
    n, m = len(vertices), len(faces)
    first = np.full(n, -1, dtype=np.int64)
    after = np.full(3 * m, -1, dtype=np.int64)
    for c in range(3 * m - 1, -1, -1):
        v = faces[c // 3, c % 3]
        after[c] = first[v]
        first[v] = c
    state = _State(
        vertices.copy(),
        faces.copy(),
        np.ones(m, dtype=np.bool_),
        first,
        after,
        np.zeros((n, 10)),
        np.zeros(n, dtype=np.int64),
        np.array([m]),
    )
    for f in range(m):
        a, b, c = faces[f]
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        cross = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
        length = np.sqrt(np.sum(cross * cross))
        if length == 0:
            continue
        normal, area = cross / length, length / 2
        for k in range(3):
            _add_plane(state.quadrics, faces[f, k], normal, -np.sum(normal * vertices[a]), area / 3)
            _add_point(state.quadrics, faces[f, k], vertices[faces[f, k]], HOLD * area / 3)
        for k in range(3):
            x, y = faces[f, k], faces[f, (k + 1) % 3]
            if _faces_at(state, x, y) == 1:
                e = vertices[y] - vertices[x]
                across = np.array(
                    [
                        e[1] * normal[2] - e[2] * normal[1],
                        e[2] * normal[0] - e[0] * normal[2],
                        e[0] * normal[1] - e[1] * normal[0],
                    ]
                )
                size = np.sqrt(np.sum(across * across))
                if size > 0:
                    across /= size
                    for w in (x, y):
                        _add_plane(
                            state.quadrics, w, across, -np.sum(across * vertices[x]), BOUNDARY_WEIGHT * size * size
                        )
    return state


@nb.njit(cache=True)
def _add_plane(quadrics: F64, v: int, n: F64, d: float, weight: float) -> None:
    q = quadrics[v]
    q[0] += weight * n[0] * n[0]
    q[1] += weight * n[0] * n[1]
    q[2] += weight * n[0] * n[2]
    q[3] += weight * n[1] * n[1]
    q[4] += weight * n[1] * n[2]
    q[5] += weight * n[2] * n[2]
    q[6] += weight * n[0] * d
    q[7] += weight * n[1] * d
    q[8] += weight * n[2] * d
    q[9] += weight * d * d


@nb.njit(cache=True)
def _add_point(quadrics: F64, v: int, p: F64, weight: float) -> None:
    q = quadrics[v]
    q[0] += weight
    q[3] += weight
    q[5] += weight
    for k in range(3):
        q[6 + k] -= weight * p[k]
    q[9] += weight * np.sum(p * p)


@nb.njit(cache=True)
def _faces_at(state: _State, x: int, y: int) -> int:
    """How many faces have the edge (x, y)."""
    count = 0
    c = state.first[x]
    while c >= 0:
        f = c // 3
        if state.alive[f] and (state.faces[f, 0] == y or state.faces[f, 1] == y or state.faces[f, 2] == y):
            count += 1
        c = state.after[c]
    return count


@nb.njit(cache=True)
def _value(q: F64, p: F64) -> float:
    return (
        q[0] * p[0] * p[0]
        + q[3] * p[1] * p[1]
        + q[5] * p[2] * p[2]
        + 2 * (q[1] * p[0] * p[1] + q[2] * p[0] * p[2] + q[4] * p[1] * p[2])
        + 2 * (q[6] * p[0] + q[7] * p[1] + q[8] * p[2])
        + q[9]
    )


@nb.njit(cache=True)
def _best(state: _State, u: int, v: int) -> tuple[float, F64]:
    """The cost of collapsing (u, v), and where the new vertex would be."""
    q = state.quadrics[u] + state.quadrics[v]
    a, b, c, d, e, f = q[0], q[1], q[2], q[3], q[4], q[5]
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    middle = (state.vertices[u] + state.vertices[v]) / 2
    trace = a + d + f
    if det > 1e-12 * trace * trace * trace:
        x, y, z = -q[6], -q[7], -q[8]
        p = np.array(
            [
                (x * (d * f - e * e) - b * (y * f - z * e) + c * (y * e - z * d)) / det,
                (a * (y * f - z * e) - x * (b * f - c * e) + c * (b * z - c * y)) / det,
                (a * (d * z - e * y) - b * (b * z - c * y) + x * (b * e - c * d)) / det,
            ]
        )
        # A solution far from the edge is one of planes that are nearly parallel.
        w = state.vertices[u] - state.vertices[v]
        if np.sum((p - middle) ** 2) <= 4 * np.sum(w * w):
            return max(_value(q, p), 0.0), p
    best, at = max(_value(q, middle), 0.0), middle
    for w in (u, v):
        cost = max(_value(q, state.vertices[w]), 0.0)
        if cost < best:
            best, at = cost, state.vertices[w].copy()
    return best, at


@nb.njit(cache=True)
def _edges_by_cost(state: _State) -> list[tuple[float, np.int64, np.int64, np.int64]]:
    heap = [(0.0, np.int64(-1), np.int64(-1), np.int64(0))]
    heap.pop()
    for f in range(len(state.faces)):
        if not state.alive[f]:
            continue
        for k in range(3):
            u, v = state.faces[f, k], state.faces[f, (k + 1) % 3]
            # Once per edge, but for edges of more than two faces.
            if u < v or not _has_directed(state, v, u):
                cost, _ = _best(state, u, v)
                heap.append((cost, u, v, state.stamps[u] + state.stamps[v]))
    heapq.heapify(heap)
    return heap


@nb.njit(cache=True)
def _has_directed(state: _State, u: int, v: int) -> bool:
    """Whether a face goes from u to v."""
    c = state.first[u]
    while c >= 0:
        if state.alive[c // 3] and state.faces[c // 3, (c % 3 + 1) % 3] == v:
            return True
        c = state.after[c]
    return False


@nb.njit(cache=True)
def _neighbours(state: _State, v: int, marks: I64, mark: int, out: I64) -> int:
    """Write the neighbours of a vertex, and mark them. Returns how many, or -1 where there is no room for them."""
    n = 0
    c = state.first[v]
    while c >= 0:
        f = c // 3
        if state.alive[f]:
            for k in range(1, 3):
                w = state.faces[f, (c % 3 + k) % 3]
                if marks[w] != mark:
                    marks[w] = mark
                    if n == len(out):
                        return -1
                    out[n] = w
                    n += 1
        c = state.after[c]
    return n


@nb.njit(cache=True)
def _turns_over(state: _State, v: int, other: int, p: F64) -> bool:
    """Whether a face of v that stays would turn too far, were v at p."""
    c = state.first[v]
    while c >= 0:
        f = c // 3
        if state.alive[f]:
            k = c % 3
            a, b = state.faces[f, (k + 1) % 3], state.faces[f, (k + 2) % 3]
            if a != other and b != other:
                s, t = state.vertices[a], state.vertices[b]
                n0 = np.cross(s - state.vertices[v], t - state.vertices[v])
                n1 = np.cross(s - p, t - p)
                if np.sum(n0 * n1) < LEAST_COSINE * np.sqrt(np.sum(n0 * n0) * np.sum(n1 * n1)):
                    return True
        c = state.after[c]
    return False


@nb.njit(cache=True)
def _least(q: F64, p: F64) -> float:
    """The least value of a quadric, found from a point by steps along the coordinates."""
    p = p.copy()
    rows = ((q[0], q[1], q[2]), (q[1], q[3], q[4]), (q[2], q[4], q[5]))
    for _ in range(20):
        for k in range(3):
            if rows[k][k] > 0:
                p[k] -= (rows[k][0] * p[0] + rows[k][1] * p[1] + rows[k][2] * p[2] + q[6 + k]) / rows[k][k]
    return max(_value(q, p), 0.0)


@nb.njit(cache=True)
def _vanish(state: _State, u: int) -> None:
    """Take away the faces that have only a vertex and its neighbours: a part that is one tetrahedron or triangle."""
    ends = np.empty(8, dtype=np.int64)
    n = 0
    c = state.first[u]
    while c >= 0:
        f = c // 3
        if state.alive[f]:
            for k in range(1, 3):
                w = state.faces[f, (c % 3 + k) % 3]
                if n < len(ends):
                    ends[n] = w
                    n += 1
        c = state.after[c]
    # Other parts may touch this one at a vertex; their faces stay.
    for i in range(n + 1):
        w = u if i == n else ends[i]
        stays = False
        c = state.first[w]
        while c >= 0:
            f = c // 3
            if state.alive[f]:
                whole = True
                for k in range(3):
                    x = state.faces[f, k]
                    if x != u and not np.any(ends[:n] == x):
                        whole = False
                if whole:
                    state.alive[f] = False
                    state.n_alive[0] -= 1
                else:
                    stays = True
            c = state.after[c]
        if not stays:
            state.first[w] = -1


@nb.njit(cache=True)
def _collapse(state: _State, n_faces: int) -> None:
    heap = _edges_by_cost(state)
    n = len(state.vertices)
    marks = np.zeros(n, dtype=np.int64)
    mark = np.int64(0)
    of_u, of_v = np.empty(MOST_NEIGHBOURS, dtype=np.int64), np.empty(MOST_NEIGHBOURS, dtype=np.int64)
    while state.n_alive[0] > n_faces and len(heap) > 0:
        cost, u, v, stamp = heapq.heappop(heap)
        if u == v:
            if state.first[u] >= 0 and 2 * state.stamps[u] == stamp:
                _vanish(state, u)
            continue
        if state.first[u] < 0 or state.first[v] < 0 or state.stamps[u] + state.stamps[v] != stamp:
            continue
        shared = _faces_at(state, u, v)
        if shared == 0:
            continue
        mark += 1
        n_v = _neighbours(state, v, marks, mark, of_v)
        mark += 1
        n_u = _neighbours(state, u, marks, mark, of_u)
        if n_u < 0 or n_v < 0:
            continue  # more neighbours than a control vertex should have
        if (shared == 2 and n_u == 3 and n_v == 3) or (shared == 1 and n_u == 2 and n_v == 2):
            # The last tetrahedron or triangle of a part goes as a whole, at the cost of shrinking it to a point.
            q = state.quadrics[u].copy()
            for i in range(n_u):
                q += state.quadrics[of_u[i]]
            heapq.heappush(heap, (max(_least(q, state.vertices[u]), cost), u, u, 2 * state.stamps[u]))
            continue
        _, p = _best(state, u, v)
        if _turns_over(state, u, v, p) or _turns_over(state, v, u, p):
            continue
        # Faces of the edge go; those of v become u's.
        state.vertices[u] = p
        state.quadrics[u] += state.quadrics[v]
        last = np.int64(-1)
        c = state.first[u]
        while c >= 0:
            f = c // 3
            if state.alive[f] and (state.faces[f, 0] == v or state.faces[f, 1] == v or state.faces[f, 2] == v):
                state.alive[f] = False
                state.n_alive[0] -= 1
            last = c
            c = state.after[c]
        state.after[last] = state.first[v]
        c = state.first[v]
        while c >= 0:
            if state.alive[c // 3]:
                state.faces[c // 3, c % 3] = u
            c = state.after[c]
        state.first[v] = -1
        # Leave out corners of faces that are gone, so that lists stay short.
        c, last = state.first[u], np.int64(-1)
        while c >= 0:
            if state.alive[c // 3]:
                last = c
            elif last < 0:
                state.first[u] = state.after[c]
            else:
                state.after[last] = state.after[c]
            c = state.after[c]
        state.stamps[u] += n  # more than any sum before
        mark += 1
        n_u = _neighbours(state, u, marks, mark, of_u)
        for i in range(n_u):
            w = of_u[i]
            cost, _ = _best(state, u, w)
            heapq.heappush(heap, (cost, u, w, state.stamps[u] + state.stamps[w]))
