"""Edges and connected components of faces: what hangs together, and how."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import F64, I64, Mask
from ..errors import require


@dataclass(frozen=True, eq=False)
class Edges:
    """Undirected edges of M faces. of: (3, M) the edge that starts at each corner of each face. count: (E,) faces at
    the edge. net: (E,) faces that run along it one way less those that run the other way."""

    of: I64
    count: I64
    net: I64

    @property
    def paired(self) -> Mask:
        """(E,) edges of exactly two faces, across which a surface goes on."""
        return self.count == 2


def edges_of(faces: I64, vertices: int) -> Edges:
    """The edges of faces that name `vertices` vertices."""
    start, end = faces.T, faces[:, [1, 2, 0]].T
    distinct, of = np.unique(np.minimum(start, end) * vertices + np.maximum(start, end), return_inverse=True)
    of = of.reshape(3, -1)
    count = np.bincount(of.ravel())
    ahead = np.bincount(of[start < end], minlength=len(distinct))
    return Edges(of, count, 2 * ahead - count)


def connected(a: I64, b: I64, nodes: int) -> I64:
    """(nodes,) component of each node of a graph whose links run from a[i] to b[i]."""
    sparse, graph = require("scipy.sparse", "compare"), require("scipy.sparse.csgraph", "compare")
    matrix = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(nodes, nodes))
    return graph.connected_components(matrix, directed=False)[1].astype(np.int64)


def chains(links: I64) -> int:
    """Number of connected chains that links (N, 2) between vertices make."""
    distinct, numbers = np.unique(links, return_inverse=True)
    numbers = numbers.reshape(-1, 2)
    return int(connected(numbers[:, 0], numbers[:, 1], len(distinct)).max(initial=-1)) + 1


def face_components(faces: I64, vertices: int) -> I64:
    """(M,) component of each face, numbered from 0 without gaps; faces that share a vertex are of one."""
    component = connected(faces[:, :2].ravel(), faces[:, 1:].ravel(), vertices)[faces[:, 0]]
    return np.unique(component, return_inverse=True)[1].astype(np.int64)


def component_boxes(vertices: F64, faces: I64, component: I64) -> tuple[F64, F64]:
    """(C, 3) least and largest coordinates of each component."""
    order = np.argsort(component, kind="stable")
    starts = np.flatnonzero(np.diff(component[order], prepend=-1))
    corners = vertices[faces[order]]
    return np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)
