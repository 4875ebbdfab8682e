"""Cut a mesh into a two-manifold: at edges of three faces and more, and at vertices where several fans meet.

The surface stays where it is; vertices are doubled. Around an edge of four faces and more, those that bound the same
piece of inside are kept together. A closed surface stays closed: the holes that are left get fans.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64, Mask
from ...mesh.connectivity import connected, edges_of
from ...mesh.holes import without_holes
from ...mesh.repair import repair
from ...mesh.sampling import face_areas


class Manifold(NamedTuple):
    """vertices: (V, 3). faces: (F, 3), a two-manifold with or without boundary, none with a vertex twice."""

    vertices: F64
    faces: I64


def cut(vertices: F64, faces: I64) -> Manifold:
    """Leave out copies of faces, turn neighbours to look the same way where they can, and cut.

    vertices: (N, 3). faces: (M, 3), none with a vertex twice.
    """
    if len(faces) == 0:
        return Manifold(vertices[:0], faces)
    closed = not edges_of(faces, len(vertices)).net.any()
    faces = repair(faces, face_areas(vertices, faces), len(vertices)).faces
    # Half edge 3 f + k goes from corner k of face f to corner k + 1.
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    keys = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    apart = np.zeros(len(keys), dtype=bool)  # half edges that become boundary
    while True:
        pairs = _pairs(vertices, faces, keys, apart)
        new = _united(faces, pairs)
        # An edge may still have several pairs, where fans run through it twice: it is opened.
        s, e = new.ravel(), new[:, [1, 2, 0]].ravel()
        _, group, count = np.unique(
            np.minimum(s, e) * (new.max() + 1) + np.maximum(s, e), return_inverse=True, return_counts=True
        )
        crowded = count[group] > 2
        if not crowded.any():
            break
        apart |= crowded
    out = np.empty((new.max() + 1, 3))
    out[new.ravel()] = vertices[faces.ravel()]
    edges = edges_of(new, len(out))
    if closed and ((edges.count == 1) == (edges.net != 0)).all():
        # What was left out, and edges that were opened, leave small holes.
        return Manifold(*without_holes(out, new))
    return Manifold(out, new)


def _pairs(vertices: F64, faces: I64, keys: I64, apart: Mask) -> I64:
    """(P, 2) half edges across which the surface goes on."""
    halves = np.flatnonzero(~apart)
    halves = halves[np.argsort(keys[halves], kind="stable")]
    first = np.flatnonzero(np.diff(keys[halves], prepend=-1))
    count = np.diff(np.append(first, len(halves)))
    two = first[count == 2]
    out = [np.column_stack([halves[two], halves[two + 1]])]
    for at, n in zip(first[count > 2], count[count > 2], strict=True):
        out.append(_around(vertices, faces, halves[at : at + n]))
    return np.concatenate(out)


def _around(vertices: F64, faces: I64, halves: I64) -> I64:
    """Pair the half edges of one edge: each with the next around the edge that runs the other way, through the inside.

    A face whose half edge runs up the edge has its inside on the side of smaller angles, seen from above; the next
    face that way that runs down closes it.
    """
    f, k = halves // 3, halves % 3
    a, b, c = (faces[f, (k + j) % 3] for j in range(3))
    low, high = min(a[0], b[0]), max(a[0], b[0])
    axis = vertices[high] - vertices[low]
    axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
    away = vertices[c] - vertices[low]
    away = away - np.outer(away @ axis, axis)
    u = away[0] / max(float(np.linalg.norm(away[0])), 1e-300)
    angle = np.arctan2(away @ np.cross(axis, u), away @ u)
    order = np.argsort(-angle, kind="stable")
    up = (a == low)[order]
    ring = halves[order]
    # Going round with falling angles, an up face opens an inside and the next down face closes it, like brackets.
    stack: list[int] = []
    pairs: list[tuple[int, int]] = []
    for i in [*range(len(ring)), *range(len(ring))]:
        taken = any(int(ring[i]) in pair for pair in pairs)
        if taken or int(ring[i]) in stack:
            continue
        if up[i]:
            stack.append(int(ring[i]))
        elif stack:
            pairs.append((stack.pop(), int(ring[i])))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _united(faces: I64, pairs: I64) -> I64:
    """(M, 3) new vertex numbers: corners of a vertex are one where the surface goes on between them."""
    corners = 3 * len(faces)
    flat = faces.ravel()
    links = []
    for k in range(2):
        # The corner at either end of the first half edge, and the corner of the second at the same vertex.
        mine = pairs[:, 0] if k == 0 else _next(pairs[:, 0])
        other = np.where(flat[pairs[:, 1]] == flat[mine], pairs[:, 1], _next(pairs[:, 1]))
        links.append(np.column_stack([mine, other]))
    both = np.concatenate(links)
    return connected(both[:, 0], both[:, 1], corners).reshape(-1, 3)


def _next(halves: I64) -> I64:
    return halves - halves % 3 + (halves + 1) % 3
