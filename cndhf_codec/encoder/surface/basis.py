"""How points of the limit surface depend on the control vertices, prepared for the fit.

The limit surface is tessellated by some levels of subdivision. Each triangle of the tessellation is curved: a quadratic
patch through its corners and the middles of its sides, which are vertices of the next level. Each of these points is a
weighted sum of control vertices, a row of a sparse matrix. All points of one control face depend on the same few
control vertices: the fit sums its normal equations face by face, in small dense blocks, which are then added up into
one sparse matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numba as nb
import numpy as np
import scipy.sparse as sp

from ...arrays import F64, I32, I64
from ...decoder.surface.subdivision import Topology, Weights, limit_positions, subdivide, topology_of
from .nearest import Tree

# Evidence for these constants: ADR 036.
FINE_FACES = 20_000  # the tessellation has about so many faces; of twice as many, 1 KiB has 0.5 % less error
LEAST_LEVELS = 2  # with one, quadratic patches are still too far off: igea at 2 KiB 1.09, with two 1.05
FEW_BENT = 0.1  # share of the faces, of those with an edge that is not sharp: then one level will do


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
    _order: list[I64] = field(default_factory=list)

    @property
    def n_faces(self) -> int:
        return len(self.ptr) - 1

    @property
    def levels(self) -> int:
        return round(math.log(len(self.fine) / self.n_faces, 4))

    def surface(self, control: F64) -> F64:
        """(N, 3) the points, for control vertices (V, 3)."""
        return np.asarray(self.matrix @ control)

    def tree(self, surface: F64) -> Tree:
        """The tessellation with points (N, 3), ready for nearest points. Its faces keep the order in the tree that they
        get at first: a fit moves them by little."""
        tree = Tree(surface, self.fine, *self._order)
        self._order[:] = [tree.order]
        return tree


def levels_of(n_faces: int, least: int = LEAST_LEVELS) -> int:
    """How often a control mesh is subdivided for the fit."""
    return min(max(round(math.log(FINE_FACES / n_faces, 4)), least), 4)


def coarsest_basis(faces: I64, n_vertices: int, sharp: I64, levels: int | None = None) -> Basis:
    """As `basis_of`, for the least work. levels: where the mesh is no polyhedron; by default as many as it needs.

    A polyhedron, all of whose edges are sharp, is its own tessellation. Where a vertex has two of them alone, as at
    corners of sheets, a curve goes through it. Where few faces are bent and there are many, one level will do.
    """
    mesh = topology_of(faces, n_vertices, sharp)
    if mesh.sharp.all() and not np.any(np.bincount(mesh.edges.ravel(), minlength=n_vertices) == 2):
        levels = 0
    elif levels is None:
        few = (~mesh.sharp)[mesh.face_edges].any(axis=1).mean() <= FEW_BENT
        levels = levels_of(len(faces), 1 if few else LEAST_LEVELS)
    return _basis(mesh, levels)


def basis_of(faces: I64, n_vertices: int, sharp: I64, levels: int) -> Basis:
    """Prepare a control mesh. sharp: (S, 2) sharp edges. levels: how often to subdivide for the tessellation."""
    return _basis(topology_of(faces, n_vertices, sharp), levels)


def _basis(mesh: Topology, levels: int) -> Basis:
    n_vertices, n_faces = mesh.n_vertices, len(mesh.faces)
    matrix = sp.identity(n_vertices, format="csr")
    owner = np.arange(n_faces)
    for _ in range(levels):
        step = subdivide(mesh)
        matrix = _sparse(step.vertices, mesh.n_vertices) @ matrix
        mesh, owner = step.topology, np.tile(owner, 4)
    fine, nodes = mesh.faces, np.column_stack([mesh.faces, mesh.n_vertices + mesh.face_edges])
    last = subdivide(mesh)
    matrix = _sparse(last.vertices, mesh.n_vertices) @ matrix
    matrix = sp.csr_matrix(_sparse(limit_positions(last.topology), last.topology.n_vertices) @ matrix)
    matrix.sort_indices()
    ptr, support = _supports(matrix.indptr, matrix.indices, nodes, n_faces, n_vertices)
    at = np.argsort(support, kind="stable")
    faces_at = np.repeat(np.arange(n_faces), np.diff(ptr))[at]
    first = np.concatenate([[0], np.cumsum(np.bincount(support, minlength=n_vertices))])
    slots, indptr, indices = _pattern(ptr, support, first, faces_at)
    return Basis(n_vertices, matrix, fine, nodes, owner, ptr, support, slots, indptr, indices)


@nb.njit(cache=True)
def _supports(indptr: I32, indices: I32, nodes: I64, n_faces: int, n_vertices: int) -> tuple[I64, I64]:
    """ptr and support of a `Basis`, from the rows of its matrix."""
    ptr = np.zeros(n_faces + 1, dtype=np.int64)
    support = np.empty(32 * n_faces, dtype=np.int64)
    seen, seen_node = np.full(n_vertices, -1), np.full(len(indptr) - 1, -1)
    n = 0
    for f in range(n_faces):
        for t in range(f, len(nodes), n_faces):  # the owner of t: a step of subdivision repeats all numbers four times
            for c in range(6):
                node = nodes[t, c]
                if seen_node[node] == f:
                    continue
                seen_node[node] = f
                for p in range(indptr[node], indptr[node + 1]):
                    v = indices[p]
                    if seen[v] != f:
                        seen[v] = f
                        if n == len(support):
                            support = np.concatenate((support, np.empty_like(support)))
                        support[n] = v
                        n += 1
        support[ptr[f] : n].sort()
        ptr[f + 1] = n
    return ptr, support[:n].copy()


@nb.njit(cache=True)
def _pattern(ptr: I64, support: I64, first: I64, faces_at: I64) -> tuple[I32, I32, I32]:
    """slots, indptr and indices of a `Basis`. faces_at: those whose support has vertex v are faces_at[first[v] :
    first[v + 1]]."""
    n_vertices = len(first) - 1
    start = np.zeros(len(ptr), dtype=np.int64)
    for f in range(len(ptr) - 1):
        start[f + 1] = start[f] + (ptr[f + 1] - ptr[f]) ** 2
    slots = np.empty(start[-1], dtype=np.int32)
    indptr = np.zeros(n_vertices + 1, dtype=np.int32)
    indices = np.empty(start[-1], dtype=np.int32)  # no row is longer than all its blocks
    seen, place = np.full(n_vertices, -1), np.empty(n_vertices, dtype=np.int32)
    n = 0
    for v in range(n_vertices):
        begin = n
        for i in range(first[v], first[v + 1]):
            for w in support[ptr[faces_at[i]] : ptr[faces_at[i] + 1]]:
                if seen[w] != v:
                    seen[w] = v
                    indices[n] = w
                    n += 1
        indices[begin:n].sort()
        for k in range(begin, n):
            place[indices[k]] = k
        for i in range(first[v], first[v + 1]):
            f = faces_at[i]
            m = ptr[f + 1] - ptr[f]
            j = np.searchsorted(support[ptr[f] : ptr[f + 1]], v)
            for k in range(m):
                slots[start[f] + j * m + k] = place[support[ptr[f] + k]]
        indptr[v + 1] = n
    return slots, indptr, indices[:n].copy()


def _sparse(weights: Weights, columns: int) -> sp.csr_matrix:
    return sp.csr_matrix((weights.weights, (weights.rows, weights.columns)), shape=(weights.n_rows, columns))
