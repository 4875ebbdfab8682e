"""Adaptive subdivision: a mesh whose triangles are of several levels, without gaps.

An edge is divided where the surface is farther from it than a tolerance. A face of three divided edges becomes four of
the next level. One of fewer is cut into triangles that meet the middles of its divided edges, and stays so: what is
finer beside it asks for its division, too. Both faces at an edge see the same middle, so nothing comes apart (ADR 038).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import F64, I64, Mask
from .levels import Level

# The triangles of a face by its divided edges: edge k, from corner k to the next, counts 2^k. Points 0 to 2 are its
# corners, 3 + k the middle of edge k.
CUTS = (
    [(0, 1, 2)],
    [(0, 3, 2), (3, 1, 2)],
    [(0, 1, 4), (0, 4, 2)],
    [(3, 1, 4), (0, 3, 4), (0, 4, 2)],
    [(0, 1, 5), (5, 1, 2)],
    [(5, 0, 3), (2, 5, 3), (2, 3, 1)],
    [(4, 2, 5), (1, 4, 5), (1, 5, 0)],
)
WHOLE = len(CUTS)  # all three


def adaptive_corners(levels: Sequence[Level], tolerance: float) -> I64:
    """Choose triangles of levels 0, 1, ... that are within a tolerance, as far as the levels go.

    Returns (M, 3) corners of faces of the last level, which have vertices and sectors: 3 f + k is corner k of face f.
    """
    divided = _divided(levels, tolerance)
    corners = np.zeros((0, 3), dtype=np.int64)
    faces = np.arange(len(levels[0].topology.faces))
    for level, edges in zip(levels[:-1], divided, strict=True):
        mesh, n = level.topology, len(level.topology.faces)
        kind = edges[mesh.face_edges[faces]] @ np.array([1, 2, 4])
        own = np.arange(3)
        # The middle of edge k is corner k of the face in the middle, which comes last of the four.
        points = np.hstack([_finer(3 * faces[:, None] + own, n), 3 * (3 * n + faces[:, None]) + own])
        cut = [points[kind == k][:, triangles].reshape(-1, 3) for k, triangles in enumerate(CUTS)]
        corners = np.concatenate([_finer(corners, n), *cut])
        faces = (n * np.arange(4)[:, None] + faces[kind == WHOLE]).ravel()
    return np.concatenate([corners, 3 * faces[:, None] + np.arange(3)])


def balanced(level: Level, corners: I64) -> F64:
    """Move the vertices of a mesh off the limit surface, so that the mesh is as much outside as inside of it.

    Between points of a surface, triangles are off to one side of it where it bends, and so add more to the mean error
    than what is off to either. A chord of length d in a curve of curvature k is k d^2 / 8 off at its middle, and its
    ends are k d^2 / 2 apart along the normal: a vertex moves by a quarter of its height over its neighbours' mean.
    Vertices on sharp edges stay.

    corners: (M, 3) as of `adaptive_corners`. Returns (V, 3) all vertices of the level.
    """
    faces, limit = level.topology.faces.ravel()[corners], level.limit
    n = len(limit)
    x = limit.T.take(faces, axis=1)
    u, v = x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]
    across = np.repeat(np.stack([u[i] * v[j] - u[j] * v[i] for i, j in ((1, 2), (2, 0), (0, 1))]), 3, axis=1)
    normals = np.stack([np.bincount(faces.ravel(), a, n) for a in across])
    # Of all corners of the faces around: three times their number, of which a third are the vertex itself.
    count = 3 * np.bincount(faces.ravel(), minlength=n)
    sums = np.stack([np.bincount(faces.ravel(), np.repeat(a, 3), n) for a in x.sum(axis=2)])
    heights = ((limit.T * count - sums) * normals).sum(axis=0) * (3 / 2)
    scale = 4 * count * (normals * normals).sum(axis=0)
    moved = (level.topology.n_sharp == 0) & (scale > 0)
    share = np.divide(heights, scale, out=np.zeros(n), where=moved)
    return limit + (share * normals).T


def _divided(levels: Sequence[Level], tolerance: float) -> list[Mask]:
    """(E,) which edges of each level but the last are divided."""
    divided = [level.distances.edges > tolerance for level in levels[:-1]]
    for k in range(len(divided) - 2, -1, -1):
        # Faces of which any edge is divided exist only where the face that they come from is divided as a whole.
        finer = divided[k + 1][levels[k + 1].topology.face_edges].any(axis=1)
        whole = finer.reshape(4, -1).any(axis=0)
        divided[k][levels[k].topology.face_edges[whole]] = True
    return divided


def _finer(corners: I64, n_faces: int) -> I64:
    """The corners of the next level at the same places; `n_faces` of this one. See `subdivision.divided`."""
    face, corner = np.divmod(corners, 3)
    return 3 * (corner * n_faces + face) + corner
