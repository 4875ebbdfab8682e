"""Edges of a triangle mesh, and whether it is a two-manifold: what the codec of connectivity can say."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int32]


class Edges(NamedTuple):
    """The edges of a mesh, without direction, in lexicographic order."""

    vertices: Ints  # (E, 2): the smaller vertex number first
    of_faces: Ints  # (F, 3): the edges from corner 0 to 1, 1 to 2, 2 to 0
    n_faces: Ints  # (E,): faces that have the edge


def edges_of(faces: Ints) -> Edges:
    """The edges of faces (F, 3)."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    keys, inverse, counts = np.unique(pairs[:, 0] << 32 | pairs[:, 1], return_inverse=True, return_counts=True)
    vertices = np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)
    return Edges(vertices, inverse.reshape(-1, 3).astype(np.int32), counts.astype(np.int32))


def fault(faces: Ints, edges: Edges) -> str | None:
    """What keeps faces (F, 3) from being a two-manifold with boundary, in words, or None.

    Faces may disagree in orientation. Of the faults, the first of the first kind is named: a repeated vertex, a number
    that no face has, an edge of three faces, two faces with the same vertices, a vertex whose faces are not one fan.
    """
    if not faces.size:
        return None
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if repeated.any():
        return f"face {int(np.argmax(repeated))} has a vertex twice"
    unused = np.bincount(faces.ravel()) == 0
    if unused.any():
        return f"vertex {int(np.argmax(unused))} has no faces"
    if edges.n_faces.max() > 2:
        k = int(np.argmax(edges.n_faces > 2))
        return f"the edge of vertices {edges.vertices[k].tolist()} has {int(edges.n_faces[k])} faces"
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    same = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    if same.any():
        return f"faces {sorted(order[int(np.argmax(same)) :][:2].tolist())} have the same vertices"
    fans = np.bincount(faces.ravel()[_first_corners(faces, edges)])
    if fans.max() > 1:
        return f"the faces at vertex {int(np.argmax(fans > 1))} are {int(fans.max())} fans"
    return None


def _first_corners(faces: Ints, edges: Edges) -> Ints:
    """The smallest corner of each fan; corner k of face f has the number 3 f + k.

    Each corner takes the smallest number that it or its neighbours in the fan point to, then what that one points to,
    until nothing changes: about as many rounds as the logarithm of the longest fan.
    """
    n_corners = faces.size
    half = np.argsort(edges.of_faces.ravel(), kind="stable")  # half-edge 3 f + k starts at corner k of face f
    starts = np.cumsum(edges.n_faces) - edges.n_faces
    inner = starts[edges.n_faces == 2]
    one, other = half[inner], half[inner + 1]
    one_end, other_end = one // 3 * 3 + (one + 1) % 3, other // 3 * 3 + (other + 1) % 3
    aligned = faces.ravel()[one] == faces.ravel()[other]
    a = np.concatenate([one, one_end])
    b = np.concatenate([np.where(aligned, other, other_end), np.where(aligned, other_end, other)])
    label = np.arange(n_corners)
    while True:
        least = label.copy()
        np.minimum.at(least, a, label[b])
        np.minimum.at(least, b, label[a])
        least = least[least]
        if np.array_equal(least, label):
            return np.flatnonzero(label == np.arange(n_corners)).astype(np.int32)
        label = least
