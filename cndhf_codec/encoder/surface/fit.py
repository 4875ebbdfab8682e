"""Fit control vertices so that the limit surface is as near to the input as can be: iterated closest points.

Each round pairs points of the two surfaces in both directions, and moves the control vertices so that the distances
along the normals (Chen and Medioni, 1991) shrink. Weights of 1 / distance make the sum of squares a sum of distances
(iteratively reweighted least squares), which is what CD measures.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
import scipy.sparse as sp

from ...arrays import F64, I32, I64
from ...mesh.sampling import face_areas
from .basis import Basis
from .target import Closest, Target, Tree

# Evidence for these constants: ADR 036.
# Distances below this share of the mean weigh no more than those at it: the weight 1 / distance has no bound.
FLOOR = 0.25
# Added to the normal matrix's diagonal, relative to its mean: it holds vertices along the surface, where planes do not.
DAMPING = 1e-3
FURTHER = 1.5  # rounds after the first go so many times as far as their solution: closest points lag behind
STEPS, TOLERANCE = 60, 1e-4  # of conjugate gradients
GOLDEN = (math.sqrt(5) - 1) / 2
OBLIQUE = 0.7  # cosine below which a closest point lies on an edge of the surface, not in a face


class Normal(NamedTuple):
    """The linearised problem: matrix (3 V, 3 V) and right-hand side (3 V,), coordinates of a vertex together; the mean
    distance at which it was set up, CD in the normalised frame, and the median."""

    matrix: sp.bsr_matrix
    side: F64
    mean: float
    median: float


class Pairs(NamedTuple):
    """Points of the surface and what they should be near to.

    faces: (K,) of the tessellation. shapes: (K, 6) weights of a patch's nodes in the point. normals: (K, 3) along which
    distances count. gaps: (K,) signed distance to go. distances: (K,). shares: (K,) of each distance in the mean of
    both directions. weights: (K,). mean: that mean.
    """

    faces: I64
    shapes: F64
    normals: F64
    gaps: F64
    distances: F64
    shares: F64
    weights: F64
    mean: float


def fit(basis: Basis, target: Target, control: F64, rounds: int) -> F64:
    """Move control vertices (V, 3) in rounds; returns the new ones."""
    for k in range(rounds):
        normal = linearised(basis, target, control)
        damping = DAMPING * normal.matrix.diagonal().mean()
        move = solved(normal.matrix, normal.side, damping).reshape(-1, 3)
        control = control + (move if k == 0 else FURTHER * move)
    return control


def linearised(basis: Basis, target: Target, control: F64, even: bool = False) -> Normal:
    """Set up the normal equations. even: all distances weigh the same, as noise does (`rounding.py`)."""
    pairs = _paired(basis, target, control, even)
    owner = basis.owner[pairs.faces]
    order = np.argsort(owner, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=basis.n_faces))])
    counts = np.diff(basis.ptr)
    start = np.concatenate([[0], np.cumsum(counts * counts)])
    blocks, sides = np.zeros((start[-1], 3, 3)), np.zeros((len(basis.support), 3))
    m = basis.matrix
    _add_up(
        _Rows(m.indptr, m.indices, m.data),
        basis.nodes,
        basis.ptr,
        basis.support,
        start,
        _Samples(order, first, pairs.faces, pairs.shapes, pairs.normals, pairs.gaps, pairs.weights),
        blocks,
        sides,
    )
    data = np.zeros((len(basis.indices), 9))
    flat = blocks.reshape(-1, 9)
    for k in range(9):
        data[:, k] = np.bincount(basis.slots, flat[:, k], len(basis.indices))
    side = np.column_stack([np.bincount(basis.support, sides[:, k], basis.n_vertices) for k in range(3)])
    n = 3 * basis.n_vertices
    matrix = sp.bsr_matrix((data.reshape(-1, 3, 3), basis.indices, basis.indptr), shape=(n, n))
    return Normal(matrix, side.ravel().astype(np.float64), pairs.mean, float(np.median(pairs.distances)))


def mean_errors(basis: Basis, target: Target, control: F64) -> F64:
    """(F,) what each control face adds to the mean distance of both directions, which is their sum."""
    pairs = _paired(basis, target, control, even=False)
    return np.asarray(np.bincount(basis.owner[pairs.faces], pairs.distances * pairs.shares, basis.n_faces))


def solved(matrix: sp.bsr_matrix, side: F64, damping: float) -> F64:
    """Solve (matrix + damping) x = side by conjugate gradients with the diagonal as preconditioner."""
    scale = 1 / (matrix.diagonal() + damping)
    x, r = np.zeros_like(side), side.copy()
    z = scale * r
    p, rz = z, float(r @ z)
    least = TOLERANCE**2 * rz
    for _ in range(STEPS):
        if rz <= least:
            break
        q = matrix @ p + damping * p
        step = rz / float(p @ q)
        x, r = x + step * p, r - step * q
        z = scale * r
        before, rz = rz, float(r @ z)
        p = z + rz / before * p
    return x


def _paired(basis: Basis, target: Target, control: F64, even: bool) -> Pairs:
    surface = basis.surface(control)
    drawn, places = _evenly(surface, basis.fine, len(target.samples))
    mine = _shapes(places)
    ours = _weighted(mine, surface[basis.nodes[drawn]])
    there = target.closest(ours)
    near = Tree(surface, basis.fine).closest(target.samples)
    nodes = surface[basis.nodes[near.faces]]
    theirs = _shapes(_nearer(nodes, _barycentric(near.points, nodes[:, :3]), target.samples))
    points = _weighted(theirs, nodes)
    here = Closest(np.linalg.norm(points - target.samples, axis=1), near.faces, points)
    mean = float(there.distances.mean() + here.distances.mean()) / 2
    distances = np.concatenate([there.distances, here.distances])
    counts = np.repeat([len(drawn), len(target.samples)], [len(drawn), len(target.samples)])
    shares = 0.5 / counts
    weights = shares / (max(mean, 1e-12) if even else np.maximum(distances, FLOOR * mean + 1e-12))
    normals = np.concatenate([target.face_normals[there.faces], target.normals])
    offsets = np.concatenate([there.points - ours, target.samples - here.points])
    gaps = np.sum(offsets * normals, axis=1)
    # Off the edge of a sheet or a crease the nearest way is not along the normal.
    oblique = (np.abs(gaps) < OBLIQUE * distances) & (distances > 1e-9)
    normals[oblique] = offsets[oblique] / distances[oblique, None]
    gaps[oblique] = distances[oblique]
    faces = np.concatenate([drawn, here.faces])
    return Pairs(faces, np.concatenate([mine, theirs]), normals, gaps, distances, shares, weights, mean)


def _evenly(surface: F64, fine: I64, count: int) -> tuple[I64, F64]:
    """Draw points that cover the surface evenly: faces (K,) and barycentric places (K, 3) in them.

    Equal steps along the running sum of areas choose the face and one coordinate; multiples of the golden ratio the
    other, which spread evenly (Weyl, 1916).
    """
    along = np.cumsum(face_areas(surface, fine))
    wanted = (np.arange(count) + 0.5) / count * along[-1]
    faces = np.minimum(np.searchsorted(along, wanted), len(fine) - 1)
    before = np.where(faces > 0, along[faces - 1], 0.0)
    root = np.sqrt(np.clip((wanted - before) / np.maximum(along[faces] - before, 1e-300), 0, 1))
    other = np.arange(count) * GOLDEN % 1
    return faces, np.column_stack([1 - root, root * (1 - other), root * other])


def _shapes(places: F64) -> F64:
    """(K, 6) weights of a patch's nodes at barycentric places (K, 3): quadratic Lagrange polynomials."""
    a, b, c = places.T
    return np.column_stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])


def _nearer(corners: F64, places: F64, samples: F64) -> F64:
    """Move places (K, 3) in patches of nodes (K, 6, 3) nearer to samples (K, 3), by a step of Gauss and Newton."""
    a, b, c = places.T
    none = np.zeros_like(a)
    # Derivatives of `_shapes` by b and by c, where a = 1 - b - c.
    by_b = np.column_stack([1 - 4 * a, 4 * b - 1, none, 4 * (a - b), 4 * c, -4 * c])
    by_c = np.column_stack([1 - 4 * a, none, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
    u, v = _weighted(by_b, corners), _weighted(by_c, corners)
    w = samples - _weighted(_shapes(places), corners)
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    area = np.maximum(uu * vv - uv * uv, 1e-300)
    b = np.clip(b + (vv * uw - uv * vw) / area, 0, 1)
    c = np.clip(c + (uu * vw - uv * uw) / area, 0, 1)
    total = np.maximum(b + c, 1)
    return np.column_stack([1 - (b + c) / total, b / total, c / total])


def _weighted(shapes: F64, nodes: F64) -> F64:
    """(K, 3) sums of nodes (K, 6, 3) with weights (K, 6)."""
    return np.asarray(np.einsum("kn,knx->kx", shapes, nodes))


def _barycentric(points: F64, corners: F64) -> F64:
    """(N, 3) barycentric coordinates of points (N, 3) in triangles (N, 3, 3)."""
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    area = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = np.clip((vv * wu - uv * wv) / area, 0, 1), np.clip((uu * wv - uv * wu) / area, 0, 1)
    return np.column_stack([1 - s - t, s, t])


class _Rows(NamedTuple):
    """A sparse matrix by rows."""

    indptr: I32
    indices: I32
    data: F64


class _Samples(NamedTuple):
    """`Pairs` by control face: those of face f are order[first[f] : first[f + 1]]."""

    order: I64
    first: I64
    faces: I64
    shapes: F64
    normals: F64
    gaps: F64
    weights: F64


@nb.njit(cache=True, parallel=True)
def _add_up(
    rows: _Rows, nodes: I64, ptr: I64, support: I64, start: I64, samples: _Samples, blocks: F64, sides: F64
) -> None:
    """Sum, for each control face, the products of its samples' rows into dense blocks of its support."""
    for f in nb.prange(len(ptr) - 1):
        m = ptr[f + 1] - ptr[f]
        row = np.zeros(m)
        for i in range(samples.first[f], samples.first[f + 1]):
            s = samples.order[i]
            row[:] = 0
            for c in range(6):
                vertex, share = nodes[samples.faces[s], c], samples.shapes[s, c]
                q = 0
                for p in range(rows.indptr[vertex], rows.indptr[vertex + 1]):
                    while support[ptr[f] + q] != rows.indices[p]:
                        q += 1
                    row[q] += share * rows.data[p]
            normal, weight = samples.normals[s], samples.weights[s]
            for j in range(m):
                if row[j] == 0:
                    continue
                a = weight * row[j]
                for x in range(3):
                    sides[ptr[f] + j, x] += a * samples.gaps[s] * normal[x]
                for k in range(m):
                    b = a * row[k]
                    if b != 0:
                        block = blocks[start[f] + j * m + k]
                        for x in range(3):
                            for y in range(3):
                                block[x, y] += b * normal[x] * normal[y]
