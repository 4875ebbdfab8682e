"""Loop's subdivision of triangle meshes with sharp edges, and its limit.

The rules are those of Loop, "Smooth Subdivision Surfaces Based on Triangles" (1987), with the sharp edges of Hoppe et
al., "Piecewise Smooth Surface Reconstruction" (1994), as in OpenSubdiv: the new vertex of a sharp edge is its middle; a
vertex with two sharp edges follows the cubic B-spline of that crease; one with three or more is a corner and stays; one
with a single sharp edge (a dart) or none moves as a smooth one. Boundary edges are sharp.

Each step and the limit are linear in the vertices. They are given as weights, which the encoder also takes for its fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F64, I64, Mask

# Neighbours of a dart this far from its sharp edge all have the same weights, up to the rounding of float64.
FARTHEST = 24


class Weights(NamedTuple):
    """A linear map from vertices to `n_rows` points: point rows[i] has weights[i] of vertex columns[i], summed."""

    rows: I64
    columns: I64
    weights: F64
    n_rows: int

    def apply(self, vertices: F64) -> F64:
        """(n_rows, 3) the points, for vertices (V, 3)."""
        # A coordinate at a time: numpy is twice as slow along rows of three.
        return np.column_stack(
            [np.bincount(self.rows, x[self.columns] * self.weights, self.n_rows) for x in vertices.T]
        )


@dataclass(frozen=True, eq=False)
class Topology:
    """Faces and edges of a mesh, and which edges are sharp.

    n_vertices: vertices are numbered from 0. faces: (F, 3). edges: (E, 2), the smaller vertex first, in any order.
    face_edges: (F, 3), the edges from a face's corner k to corner k + 1. sharp: (E,), boundary edges included.
    """

    n_vertices: int
    faces: I64
    edges: I64
    face_edges: I64
    sharp: Mask

    @property
    def valences(self) -> I64:
        """(V,) how many edges a vertex has."""
        return np.bincount(self.edges.ravel(), minlength=self.n_vertices)

    @property
    def n_sharp(self) -> I64:
        """(V,) how many sharp edges a vertex has."""
        return np.bincount(self.edges[self.sharp].ravel(), minlength=self.n_vertices)


class Step(NamedTuple):
    """One step of subdivision: the new vertices from the old, and the mesh that they form."""

    vertices: Weights
    topology: Topology


def topology_of(faces: npt.ArrayLike, n_vertices: int, sharp: npt.ArrayLike) -> Topology:
    """Find the edges of a mesh.

    faces: (F, 3) int. sharp: (S, 2) int, sharp edges, the smaller vertex first; pairs that are no edges are ignored.
    """
    f = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    ends = np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, inverse, counts = np.unique(ends[:, 0] * n_vertices + ends[:, 1], return_inverse=True, return_counts=True)
    edges = np.column_stack([keys // n_vertices, keys % n_vertices])
    pairs = np.asarray(sharp, dtype=np.int64).reshape(-1, 2)
    marked = np.isin(keys, pairs[:, 0] * n_vertices + pairs[:, 1])
    return Topology(n_vertices, f, edges, inverse.reshape(-1, 3), marked | (counts == 1))


def subdivide(mesh: Topology) -> Step:
    """Divide each face in four. Old vertices keep their numbers; the vertex of edge e has the number V + e.

    The four faces of face i have the numbers i, F + i, 2 F + i and 3 F + i: three at its corners, the last in its
    middle.
    """
    return Step(step_weights(mesh), divided(mesh))


def step_weights(mesh: Topology) -> Weights:
    """The vertices after one step: the V old ones, moved, then one per edge."""
    n, edges, sharp = mesh.n_vertices, mesh.edges, mesh.sharp
    kinds = _kinds(mesh)
    # Old vertices: smooth by Loop's beta, creases 1/8 3/4 1/8, corners unchanged.
    beta = _beta(mesh.valences)
    ring = _ring(mesh, kinds, beta, 1 / 8)
    own = np.where(kinds.smooth, 1 - mesh.valences * beta, np.where(kinds.crease, 3 / 4, 1.0))
    # New vertices: 3/8 of the ends and 1/8 of the corners across, or the middle of a sharp edge.
    at = n + np.arange(len(edges))
    ends = np.where(sharp, 1 / 2, 3 / 8)
    across = ~sharp[mesh.face_edges]
    corners = mesh.faces[:, [2, 0, 1]]
    return Weights(
        np.concatenate([np.arange(n), ring.rows, at, at, n + mesh.face_edges[across]]),
        np.concatenate([np.arange(n), ring.columns, edges[:, 0], edges[:, 1], corners[across]]),
        np.concatenate([own, ring.weights, ends, ends, np.full(np.count_nonzero(across), 1 / 8)]),
        n + len(edges),
    )


def divided(mesh: Topology) -> Topology:
    """Faces and edges after one step.

    Edges: the halves of the old ones at their first ends, those at their second ends, then three per face, near its
    corners. So nothing has to be sorted, which would take longer than all the rest.
    """
    n, n_edges, n_faces = mesh.n_vertices, len(mesh.edges), len(mesh.faces)
    at = n + np.arange(n_edges)
    middle = n + mesh.face_edges
    (a, b, c), (ab, bc, ca) = mesh.faces.T, middle.T
    # (F, 3) the halves of the face's edges k at its corners k, and at its corners k + 1.
    second = mesh.faces != mesh.edges[mesh.face_edges, 0]
    here = mesh.face_edges + n_edges * second
    there = mesh.face_edges + n_edges * ~second
    near_a, near_b, near_c = (2 * n_edges + k * n_faces + np.arange(n_faces) for k in range(3))
    faces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    face_edges = [
        (here[:, 0], near_a, there[:, 2]),
        (there[:, 0], here[:, 1], near_b),
        (near_c, there[:, 1], here[:, 2]),
        (near_b, near_c, near_a),
    ]
    inner = np.concatenate([middle[:, [2, 0]], middle[:, [0, 1]], middle[:, [1, 2]]])
    edges = [np.column_stack([mesh.edges[:, k], at]) for k in range(2)] + [np.sort(inner, axis=1)]
    return Topology(
        n + n_edges,
        np.concatenate([np.column_stack(t) for t in faces]),
        np.concatenate(edges),
        np.concatenate([np.column_stack(t) for t in face_edges]),
        np.concatenate([mesh.sharp, mesh.sharp, np.zeros(3 * n_faces, dtype=bool)]),
    )


def limit_positions(mesh: Topology) -> Weights:
    """The points of the limit surface that belong to the vertices of a mesh.

    Smooth: w = 1 / (3 / (8 beta) + n) of each of n neighbours and 1 - n w of the vertex; creases 1/6 2/3 1/6; corners
    stay. These are the left eigenvectors of the subdivision rules (Hoppe et al., 1994). Darts have one of their own:
    see `_dart_limits`.
    """
    valences, n_sharp = mesh.valences, mesh.n_sharp
    kinds = _Kinds(n_sharp == 0, n_sharp == 2)
    share = 1 / (3 / (8 * _beta(valences)) + np.maximum(valences, 1))
    ring = _ring(mesh, kinds, share, 1 / 6)
    own = np.where(kinds.smooth, 1 - valences * share, np.where(kinds.crease, 2 / 3, 1.0))
    others = np.flatnonzero(n_sharp != 1)
    darts = _dart_limits(mesh, n_sharp == 1)
    return Weights(
        np.concatenate([others, ring.rows, darts.rows]),
        np.concatenate([others, ring.columns, darts.columns]),
        np.concatenate([own[others], ring.weights, darts.weights]),
        mesh.n_vertices,
    )


def _dart_limits(mesh: Topology, darts: Mask) -> Weights:
    """The points of the limit surface of darts (V,), vertices with a single sharp edge.

    In each step the neighbour along the sharp edge, 0, becomes 1/2 1/2, and the others 3/8 3/8 1/8 1/8. So the weights
    w_i of neighbours, for weight 1 of the vertex, satisfy

        5/8 w_i = beta + (w_(i - 1) + w_(i + 1)) / 8    (where w_0 counts as 0)
        1/2 w_0 = beta + (w_1 + w_(n - 1)) / 8

    Hence w_i = 8/3 beta (1 - (r^i + r^(n - i)) / (1 + r^n)) with r + 1 / r = 5.
    """
    rows, columns = (np.concatenate([mesh.edges[:, k], mesh.edges[:, 1 - k]]) for k in range(2))
    spokes = np.flatnonzero(darts[rows])  # edge e has the numbers e, at its first end, and E + e
    rows, columns = rows[spokes], columns[spokes]
    place = _from_sharp(mesh, darts, spokes)
    n, beta = mesh.valences[rows], _beta(mesh.valences)[rows]
    r = (5 - np.sqrt(21)) / 2
    weights = 8 / 3 * beta * (1 - (r**place + r ** (n - place)) / (1 + r**n))
    next_to = np.zeros(mesh.n_vertices)
    next_to[rows[place == 1]] = weights[place == 1]
    weights = np.where(place == 0, 2 * beta + next_to[rows] / 2, weights)
    sums = 1 + np.bincount(rows, weights, mesh.n_vertices)
    own = np.flatnonzero(darts)
    return Weights(
        np.concatenate([own, rows]),
        np.concatenate([own, columns]),
        np.concatenate([1 / sums[own], weights / sums[rows]]),
        mesh.n_vertices,
    )


def _from_sharp(mesh: Topology, darts: Mask, spokes: I64) -> I64:
    """How many faces lie between the spokes of darts and the sharp one, at most `FARTHEST`.

    spokes: (S,) numbers, rising: edge e has the numbers e, at its first end, and E + e.
    """
    n_edges = len(mesh.edges)
    place = np.where(mesh.sharp[spokes % n_edges], 0, FARTHEST)
    face, corner = np.nonzero(darts[mesh.faces])
    pair = []
    for k in (corner, (corner + 2) % 3):  # the edges that start and end at the corner
        edge = mesh.face_edges[face, k]
        at_second = mesh.edges[edge, 0] != mesh.faces[face, corner]
        pair.append(np.searchsorted(spokes, edge + n_edges * at_second))
    for _ in range(FARTHEST):
        before = place.copy()
        for a, b in (pair, pair[::-1]):
            np.minimum.at(place, a, before[b] + 1)
        if np.array_equal(place, before):
            break
    return place


class _Kinds(NamedTuple):
    smooth: Mask
    crease: Mask


def _kinds(mesh: Topology) -> _Kinds:
    """(V,) which vertices are smooth, and which lie on a crease; the others are corners."""
    n_sharp = mesh.n_sharp
    return _Kinds(n_sharp < 2, n_sharp == 2)


def _beta(valences: I64) -> F64:
    """(V,) Loop's weight of each neighbour of a smooth vertex."""
    n = np.maximum(valences, 1)
    return (5 / 8 - (3 / 8 + np.cos(2 * np.pi / n) / 4) ** 2) / n


def _ring(mesh: Topology, kinds: _Kinds, smooth: F64, crease: float) -> Weights:
    """The weights of neighbours: `smooth` (V,) of all around a smooth vertex, `crease` of the two along a crease."""
    rows = np.concatenate([mesh.edges[:, 0], mesh.edges[:, 1]])
    columns = np.concatenate([mesh.edges[:, 1], mesh.edges[:, 0]])
    along = np.tile(mesh.sharp, 2) & kinds.crease[rows]
    used = kinds.smooth[rows] | along
    weights = np.where(along, crease, smooth[rows])
    return Weights(rows[used], columns[used], weights[used], mesh.n_vertices)
