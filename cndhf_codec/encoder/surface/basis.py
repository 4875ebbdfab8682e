"""How points of the limit surface depend on the control vertices, prepared for the fit.

The limit surface is tessellated by some levels of subdivision. Each triangle of the tessellation is curved: a quadratic
patch through its corners and the middles of its sides, which are vertices of the next level. Each of these points is a
weighted sum of control vertices, a row of a sparse matrix. All points of one control face depend on the same few
control vertices: the fit sums its normal equations face by face, in small dense blocks, which are then added up into
one sparse matrix.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ...arrays import F64, I32, I64
from ...decoder.surface.subdivision import Weights, limit_positions, subdivide, topology_of


@dataclass(frozen=True, eq=False)
class Basis:
    """The limit surface of a control mesh of V vertices and F faces, tessellated.

    matrix: (N, V) sparse, points of the limit surface from the control vertices. fine: (M, 3) the corners of the
    tessellation's faces. nodes: (M, 6) the nodes of their patches: the corners, then the middles of the sides that
    follow each. owner: (M,) the control face of each. ptr, support: the control vertices that face f depends on are
    support[ptr[f] : ptr[f + 1]], ascending. slots: where each pair of them stands in the normal matrix, block by block;
    indptr, indices: the normal matrix in blocks of 3 by 3 (`scipy.sparse.bsr_array`).
    """

    n_vertices: int
    matrix: sp.csr_matrix
    fine: I64
    nodes: I64
    owner: I64
    ptr: I64
    support: I64
    slots: I32
    indptr: I32
    indices: I32

    @property
    def n_faces(self) -> int:
        return len(self.ptr) - 1

    def surface(self, control: F64) -> F64:
        """(N, 3) the points, for control vertices (V, 3)."""
        return np.asarray(self.matrix @ control)


def basis_of(faces: I64, n_vertices: int, sharp: I64, levels: int) -> Basis:
    """Prepare a control mesh. sharp: (S, 2) sharp edges. levels: how often to subdivide for the tessellation."""
    mesh = topology_of(faces, n_vertices, sharp)
    matrix = sp.identity(n_vertices, format="csr")
    owner = np.arange(len(faces))
    for _ in range(levels):
        step = subdivide(mesh)
        matrix = _sparse(step.vertices, mesh.n_vertices) @ matrix
        mesh, owner = step.topology, np.tile(owner, 4)
    fine, nodes = mesh.faces, np.column_stack([mesh.faces, mesh.n_vertices + mesh.face_edges])
    last = subdivide(mesh)
    matrix = _sparse(last.vertices, mesh.n_vertices) @ matrix
    matrix = sp.csr_matrix(_sparse(limit_positions(last.topology), last.topology.n_vertices) @ matrix)
    matrix.sort_indices()
    corners = sp.csr_matrix(
        (np.ones(6 * len(owner)), (np.repeat(owner, 6), nodes.ravel())), shape=(len(faces), matrix.shape[0])
    )
    # abs: weights may be negative, and must not cancel here.
    touched = sp.csr_matrix(corners @ abs(matrix))
    touched.sort_indices()
    ptr, support = touched.indptr.astype(np.int64), touched.indices.astype(np.int64)
    counts = np.diff(ptr)
    row = np.repeat(support, np.repeat(counts, counts))
    column = np.concatenate([np.tile(support[a:b], b - a) for a, b in itertools.pairwise(ptr)])
    keys, slots = np.unique(row * n_vertices + column, return_inverse=True)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(keys // n_vertices, minlength=n_vertices))])
    return Basis(
        n_vertices,
        matrix,
        fine,
        nodes,
        owner,
        ptr,
        support,
        slots.astype(np.int32).ravel(),
        indptr.astype(np.int32),
        (keys % n_vertices).astype(np.int32),
    )


def _sparse(weights: Weights, columns: int) -> sp.csr_matrix:
    return sp.csr_matrix((weights.weights, (weights.rows, weights.columns)), shape=(weights.n_rows, columns))
