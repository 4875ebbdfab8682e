"""Close the holes of a surface."""

from __future__ import annotations

import numpy as np

from ..arrays import F64, I64
from .connectivity import connected, edges_of


def without_holes(vertices: F64, faces: I64) -> tuple[F64, I64]:
    """Close each hole by a fan around the middle of its rim. The vertices and faces that were given come first.

    Edges along which more faces run one way than the other form closed curves. So a fan from any point, of as many
    faces as are missing at each edge, leaves none.
    """
    edges = edges_of(faces, len(vertices))
    start, end = faces.T, faces[:, [1, 2, 0]].T
    # One corner per unbalanced edge, whose face runs as most do there.
    net = edges.net[edges.of]
    fitting = np.flatnonzero((net * np.where(start < end, 1, -1) > 0).ravel())
    first = fitting[np.unique(edges.of.ravel()[fitting], return_index=True)[1]]
    if not len(first):
        return vertices, faces
    a, b, missing = start.ravel()[first], end.ravel()[first], np.abs(net.ravel()[first])
    rim, numbers = np.unique(np.stack([a, b]), return_inverse=True)
    numbers = numbers.reshape(2, -1)
    hole = connected(numbers[0], numbers[1], len(rim))[numbers[0]]
    hole = np.unique(hole, return_inverse=True)[1]
    length = np.linalg.norm(vertices[b] - vertices[a], axis=1)
    middle = (vertices[a] + vertices[b]) / 2
    whole = np.bincount(hole, weights=length)
    tips = np.stack([np.bincount(hole, weights=length * middle[:, k]) / whole for k in range(3)], axis=1)
    fans = np.repeat(np.stack([b, a, len(vertices) + hole], axis=1), missing, axis=0)
    return np.concatenate([vertices, tips]), np.concatenate([faces, fans])
