"""Edges and connected components of faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import F64, I64, Mask
from ..errors import require


@dataclass(frozen=True, eq=False)
class Edges:
    """Undirected edges of M faces.

    of: (3, M) the edge that starts at each corner of each face. count: (E,) number of faces at the edge. net: (E,)
    faces that run along the edge from its lower to its higher vertex, less those that run the other way.
    """

    of: I64
    count: I64
    net: I64

    @property
    def paired(self) -> Mask:
        """(E,) whether the edge has exactly two faces, so that the surface continues across it."""
        return self.count == 2


def edges_of(faces: I64, vertices: int) -> Edges:
    """Find the edges of faces. vertices: how many vertices there are."""
    start, end = faces.T, faces[:, [1, 2, 0]].T
    distinct, of = np.unique(np.minimum(start, end) * vertices + np.maximum(start, end), return_inverse=True)
    of = of.reshape(3, -1)
    count = np.bincount(of.ravel())
    ahead = np.bincount(of[start < end], minlength=len(distinct))
    return Edges(of, count, 2 * ahead - count)


def connected(a: I64, b: I64, nodes: int) -> I64:
    """Number the connected components of a graph with links from a[i] to b[i]: (nodes,) component of each node."""
    sparse, graph = require("scipy.sparse", "compare"), require("scipy.sparse.csgraph", "compare")
    matrix = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(nodes, nodes))
    return graph.connected_components(matrix, directed=False)[1].astype(np.int64)


def chains(links: I64) -> int:
    """Count the connected chains of links (N, 2) between vertices."""
    distinct, numbers = np.unique(links, return_inverse=True)
    numbers = numbers.reshape(-1, 2)
    return int(connected(numbers[:, 0], numbers[:, 1], len(distinct)).max(initial=-1)) + 1


def face_components(faces: I64, vertices: int) -> I64:
    """(M,) component of each face, numbered from 0 without gaps. Faces that share a vertex are in one component."""
    component = connected(faces[:, :2].ravel(), faces[:, 1:].ravel(), vertices)[faces[:, 0]]
    return np.unique(component, return_inverse=True)[1].astype(np.int64)


def component_boxes(vertices: F64, faces: I64, component: I64) -> tuple[F64, F64]:
    """Least and greatest coordinates of each component, (C, 3) each."""
    order = np.argsort(component, kind="stable")
    starts = np.flatnonzero(np.diff(component[order], prepend=-1))
    corners = vertices[faces[order]]
    return np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)
