"""Fit control vertices so that the limit surface is as near to the input as can be: iterated closest points.

Each round pairs points of the two surfaces in both directions, and moves the control vertices so that the distances
along the normals (Chen and Medioni, 1991) shrink. Weights of 1 / distance make the sum of squares a sum of distances
(iteratively reweighted least squares), which is what CD measures.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
import scipy.sparse as sp

from ...arrays import F64, I32, I64
from ...mesh.sampling import cover_evenly
from .basis import Basis
from .target import Target

# Evidence for these constants: ADR 036.
# Distances below this share of the mean weigh no more than those at it: the weight 1 / distance has no bound.
FLOOR = 0.25
# Added to the normal matrix's diagonal, relative to its mean: it holds vertices along the surface, where planes do not.
DAMPING = 1e-3
FURTHER = 1.5  # rounds after the first go so many times as far as their solution: closest points lag behind
STEPS, TOLERANCE = 60, 1e-4  # of conjugate gradients
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
    data, side = np.zeros((len(basis.indices), 3, 3)), np.zeros((basis.n_vertices, 3))
    _scatter(basis.slots, blocks, data)
    _scatter(basis.support, sides, side)
    n = 3 * basis.n_vertices
    matrix = sp.bsr_matrix((data, basis.indices, basis.indptr), shape=(n, n))
    return Normal(matrix, side.ravel(), pairs.mean, float(np.median(pairs.distances)))


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
    tree = basis.tree(surface)
    # In the tree's order neighbours follow each other.
    drawn, places = cover_evenly(surface, basis.fine[tree.order], len(target.samples))
    drawn = tree.order[drawn]
    mine, ours = _points_at(surface, basis.nodes, drawn, places)
    there = target.closest(ours)
    near = tree.closest(target.samples)
    theirs, here = _points_near(surface, basis.nodes, near.faces, near.points, target.samples)
    normals = np.concatenate([target.face_normals[there.faces], target.normals])
    offsets = np.concatenate([there.points - ours, target.samples - here])
    gaps, distances = _gaps(normals, offsets)
    n = len(drawn)
    mean = float(distances[:n].mean() + distances[n:].mean()) / 2
    shares = np.repeat([0.5 / n, 0.5 / (len(distances) - n)], [n, len(distances) - n])
    weights = shares / (max(mean, 1e-12) if even else np.maximum(distances, FLOOR * mean + 1e-12))
    faces = np.concatenate([drawn, near.faces])
    return Pairs(faces, np.concatenate([mine, theirs]), normals, gaps, distances, shares, weights, mean)


@nb.njit(cache=True)
def _shape(a: float, b: float, c: float) -> tuple[float, float, float, float, float, float]:
    """Weights of a patch's nodes at barycentric coordinates: quadratic Lagrange polynomials."""
    return a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a


@nb.njit(cache=True, parallel=True)
def _points_at(surface: F64, nodes: I64, faces: I64, places: F64) -> tuple[F64, F64]:
    """Points at barycentric places (K, 3) in the patches of faces (K,): (K, 6) weights of the nodes, (K, 3) points."""
    shapes, points = np.empty((len(faces), 6)), np.zeros((len(faces), 3))
    for i in nb.prange(len(faces)):
        shape = _shape(places[i, 0], places[i, 1], places[i, 2])
        for n in range(6):
            shapes[i, n] = shape[n]
            for k in range(3):
                points[i, k] += shape[n] * surface[nodes[faces[i], n], k]
    return shapes, points


@nb.njit(cache=True, parallel=True)
def _points_near(surface: F64, nodes: I64, faces: I64, nearest: F64, samples: F64) -> tuple[F64, F64]:
    """Points of patches near samples (K, 3), as in `_points_at`. nearest: (K, 3) the points of the flat faces (K,) that
    are nearest; in the curved patches, a step of Gauss and Newton goes on from there."""
    shapes, points = np.empty((len(faces), 6)), np.zeros((len(faces), 3))
    for i in nb.prange(len(faces)):
        at = nodes[faces[i]]
        plane, curve = _Squares(0.0, 0.0, 0.0, 0.0, 0.0), _Squares(0.0, 0.0, 0.0, 0.0, 0.0)
        for k in range(3):
            first = surface[at[0], k]
            plane = _added(plane, surface[at[1], k] - first, surface[at[2], k] - first, nearest[i, k] - first)
        b, c = _least(plane)
        b, c = min(max(b, 0.0), 1.0), min(max(c, 0.0), 1.0)
        a = 1 - b - c
        shape = _shape(a, b, c)
        # Derivatives of `_shape` by b and by c, where a = 1 - b - c.
        by_b = (1 - 4 * a, 4 * b - 1, 0.0, 4 * (a - b), 4 * c, -4 * c)
        by_c = (1 - 4 * a, 0.0, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c))
        for k in range(3):
            u, v, w = 0.0, 0.0, samples[i, k]
            for n in range(6):
                x = surface[at[n], k]
                u += by_b[n] * x
                v += by_c[n] * x
                w -= shape[n] * x
            curve = _added(curve, u, v, w)
        db, dc = _least(curve)
        b, c = min(max(b + db, 0.0), 1.0), min(max(c + dc, 0.0), 1.0)
        total = max(b + c, 1.0)
        shape = _shape(1 - (b + c) / total, b / total, c / total)
        for n in range(6):
            shapes[i, n] = shape[n]
            for k in range(3):
                points[i, k] += shape[n] * surface[at[n], k]
    return shapes, points


class _Squares(NamedTuple):
    """Scalar products of three vectors u, v and w."""

    uu: float
    uv: float
    vv: float
    uw: float
    vw: float


@nb.njit(cache=True)
def _added(s: _Squares, u: float, v: float, w: float) -> _Squares:
    """The products with one coordinate more."""
    return _Squares(s.uu + u * u, s.uv + u * v, s.vv + v * v, s.uw + u * w, s.vw + v * w)


@nb.njit(cache=True)
def _least(s: _Squares) -> tuple[float, float]:
    """b and c with which b u + c v is nearest to w."""
    area = max(s.uu * s.vv - s.uv * s.uv, 1e-300)
    return (s.vv * s.uw - s.uv * s.vw) / area, (s.uu * s.vw - s.uv * s.uw) / area


@nb.njit(cache=True, parallel=True)
def _gaps(normals: F64, offsets: F64) -> tuple[F64, F64]:
    """(K,) signed distances along normals (K, 3), and distances, of offsets (K, 3). Where the nearest way is not along
    the normal, off the edge of a sheet or a crease, the normal becomes the offset's direction."""
    gaps, distances = np.empty(len(normals)), np.empty(len(normals))
    for i in nb.prange(len(normals)):
        x, y, z = offsets[i, 0], offsets[i, 1], offsets[i, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        gap = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
        if distance > 1e-9 and np.abs(gap) < OBLIQUE * distance:
            gap = distance
            normals[i, 0], normals[i, 1], normals[i, 2] = x / distance, y / distance, z / distance
        gaps[i], distances[i] = gap, distance
    return gaps, distances


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
        # The six different products of a normal's coordinates, each for all pairs k <= j: such rows are added fast.
        sums = np.zeros((6, m, m))
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
            weight = samples.weights[s]
            x, y, z = samples.normals[s, 0], samples.normals[s, 1], samples.normals[s, 2]
            products = (weight * x * x, weight * x * y, weight * x * z, weight * y * y, weight * y * z, weight * z * z)
            far = weight * samples.gaps[s]
            for j in range(m):
                a = row[j]
                if a == 0:
                    continue
                side = sides[ptr[f] + j]
                side[0] += a * far * x
                side[1] += a * far * y
                side[2] += a * far * z
                for c in range(6):
                    b, line = a * products[c], sums[c, j]
                    for k in range(j + 1):
                        line[k] += b * row[k]
        for j in range(m):
            for k in range(m):
                block, u, v = blocks[start[f] + j * m + k], max(j, k), min(j, k)
                block[0, 0], block[1, 1], block[2, 2] = sums[0, u, v], sums[3, u, v], sums[5, u, v]
                block[0, 1] = block[1, 0] = sums[1, u, v]
                block[0, 2] = block[2, 0] = sums[2, u, v]
                block[1, 2] = block[2, 1] = sums[4, u, v]


@nb.njit(cache=True)
def _scatter(to: I64, values: F64, out: F64) -> None:
    """Add values to where they belong, those of one place in their order."""
    flat, wide = values.reshape(len(to), -1), out.reshape(len(out), -1)
    for i in range(len(to)):
        for k in range(flat.shape[1]):
            wide[to[i], k] += flat[i, k]
