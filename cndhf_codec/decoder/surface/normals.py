"""Normals of the limit surface at the vertices of a control mesh.

Across a sharp edge the surface bends, so a normal belongs to a *sector*: the corners of faces around a vertex between
one sharp edge and the next, or all around a vertex where there are fewer than two.

- Smooth vertices: the cross product of the two tangents, sums of the n neighbours by cos(2 pi i / n) and
  sin(2 pi i / n) (Loop 1987). A dart is taken as smooth.
- Sectors of vertices on a crease: the tangent along it and the one-sided tangent across (Hoppe et al. 1994, here for
  the rules of subdivision.py).
- Sectors of corners, and what the above leaves without a direction: the normals of the triangles between limit points,
  by their angles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64, Mask
from ..results import ShadedMesh, TriangleMesh
from .subdivision import Topology, topology_of

# Of a simplified mesh. Corners are looked at so far towards the middles of their faces, to be off creases.
INWARD = 0.1
CREASE_COSINE = 0.866  # 30 degrees, as modelling programs shade
ACROSS_COSINE = 0.5  # a normal that is further from the face's belongs to another


class Sectors(NamedTuple):
    """The sectors of a mesh, in the order of their vertices.

    vertices: (S,) their vertices. corners: (F, 3) the sector of each corner of a face. places: (F, 3) its place in the
    sector, from 0, anticlockwise seen from outside. sizes: (S,) how many corners they have.
    """

    vertices: I64
    corners: I64
    places: I64
    sizes: I64


def sectors_of(mesh: Topology) -> Sectors:
    """Find the sectors of a mesh. Where neighbours disagree in orientation, a sector ends, too."""
    n_corners = mesh.faces.size
    corner = np.arange(n_corners)
    vertex = mesh.faces.ravel()
    ahead, behind = mesh.face_edges.ravel(), mesh.face_edges[:, [2, 0, 1]].ravel()
    # A corner's edge ahead, as it leaves its vertex, has a number of its own; so the next corner is found by the edge
    # behind. Of two corners with one number, whose faces disagree, none is next to the other.
    leaving = 2 * ahead + (mesh.edges[ahead, 0] != vertex)
    entering = 2 * behind + (mesh.edges[behind, 0] != vertex)
    owner = np.full(2 * len(mesh.edges), -1)
    owner[leaving] = corner
    following = np.where(mesh.sharp[behind], -1, owner[entering])
    first = np.ones(n_corners, dtype=bool)
    first[following[following >= 0]] = False
    sector, place = np.full(n_corners, -1), np.zeros(n_corners, dtype=np.int64)
    _walk(np.flatnonzero(first), following, sector, place)
    # What is left are rings without an end: they start at the first corner of their vertex.
    left = np.flatnonzero(sector < 0)
    _walk(left[np.unique(vertex[left], return_index=True)[1]], following, sector, place)
    start = np.flatnonzero(sector == corner)
    order = start[np.argsort(vertex[start], kind="stable")]
    number = np.empty(n_corners, dtype=np.int64)
    number[order] = np.arange(len(order))
    corners = number[sector]
    return Sectors(
        vertex[order], corners.reshape(-1, 3), place.reshape(-1, 3), np.bincount(corners, minlength=len(order))
    )


def with_normals(mesh: TriangleMesh, normals_at: Callable[[F64], F64]) -> ShadedMesh:
    """Give a mesh that is near a surface the surface's normals, with a vertex per sector.

    normals_at: the surface's normals (N, 3) nearest to points (N, 3). An edge is a crease where they differ between its
    two faces.
    """
    p = mesh.vertices[mesh.faces]
    inside = p + INWARD * (p.mean(axis=1, keepdims=True) - p)
    corners = normals_at(inside.reshape(-1, 3)).reshape(-1, 3, 3)
    # Beside a crease the nearest point may be across it; then the face has a normal of its own.
    own = np.broadcast_to(unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))[:, None], corners.shape)
    corners = np.where(np.sum(own * corners, axis=2, keepdims=True) < ACROSS_COSINE, own, corners)
    plain = topology_of(mesh.faces, len(mesh.vertices), np.zeros((0, 2)))
    # At each edge: the sum of the unit normals of both faces, each between its two ends; |a + b|^2 = 2 + 2 cos.
    total = np.zeros((len(plain.edges), 3))
    for k in range(3):
        total += _summed(plain.face_edges[:, k], unit(corners[:, k] + corners[:, (k + 1) % 3]), len(total))
    crease = (total * total).sum(axis=1) / 2 - 1 < CREASE_COSINE
    sectors = sectors_of(replace(plain, sharp=plain.sharp | crease))
    normals = unit(_summed(sectors.corners.ravel(), corners.reshape(-1, 3), len(sectors.vertices)))
    return ShadedMesh(mesh.vertices[sectors.vertices], sectors.corners, normals)


def _walk(start: I64, following: I64, sector: I64, place: I64) -> None:
    """Number the corners from each of `start` on: sector and place, both (3 F,), in place."""
    name, at, k = start, start, 0
    while len(at):
        sector[at], place[at] = name, k
        at, k = following[at], k + 1
        on = (at >= 0) & (sector[np.maximum(at, 0)] < 0)
        name, at = name[on], at[on]


def limit_normals(mesh: Topology, vertices: F64, limit: F64, sectors: Sectors) -> F64:
    """(S, 3) unit normals of the limit surface at each sector.

    vertices, limit: (V, 3) the vertices of the mesh and their limit points.
    """
    size, at = sectors.sizes, sectors.vertices
    n_sharp, valences = mesh.n_sharp[at], mesh.valences[at]
    sector, place = sectors.corners.ravel(), sectors.places.ravel()
    is_last = place == size[sector] - 1
    # Sectors also end where orientation changes; the tangents are only known from sharp edge to sharp edge.
    from_sharp, to_sharp = np.zeros(len(size), dtype=bool), np.zeros(len(size), dtype=bool)
    from_sharp[sector[place == 0]] = mesh.sharp[mesh.face_edges.ravel()[place == 0]]
    to_sharp[sector[is_last]] = mesh.sharp[mesh.face_edges[:, [2, 0, 1]].ravel()[is_last]]
    smooth, crease = (n_sharp < 2) & (size == valences), (n_sharp == 2) & from_sharp & to_sharp
    x, y = _weights(sectors, smooth, crease)
    arms = vertices[mesh.faces[:, [1, 2, 0]].ravel()] - vertices[mesh.faces.ravel()]
    u, v = _summed(sector, arms * x[:, None], len(size)), _summed(sector, arms * y[:, None], len(size))
    # A crease has one arm more than corners: the edge behind the last one.
    last = np.flatnonzero(is_last & crease[sector])
    of = sector[last]
    arm = vertices[mesh.faces[:, [2, 0, 1]].ravel()[last]] - vertices[mesh.faces.ravel()[last]]
    u[of] -= arm
    v[of] += arm * _crease_end(size[of])[:, None]
    normals = unit(np.cross(u, v))
    unknown = ~(smooth | crease) | ~normals.any(axis=1)
    if unknown.any():
        normals[unknown] = unit(_by_angles(mesh, limit, sectors))[unknown]
    return normals


def _weights(sectors: Sectors, smooth: Mask, crease: Mask) -> tuple[F64, F64]:
    """(3 F,) the weights, in both tangents, of the arm ahead of each corner."""
    sector, place = sectors.corners.ravel(), sectors.places.ravel()
    size = sectors.sizes[sector]
    angle = np.where(smooth[sector], 2 * np.pi, np.pi) * place / size
    x, y = np.cos(angle), np.sin(angle)
    on_crease = crease[sector]
    x[on_crease] = place[on_crease] == 0  # along: from the last arm to the first
    ends = on_crease & (place == 0)
    y[ends] = _crease_end(size[ends])
    return x, y


def _crease_end(size: I64) -> F64:
    """The weight of the two arms along a crease in the tangent across it, for a sector of `size` faces.

    The other arms have sin(i pi / size). With the weights of subdivision.py, the left eigenvector of the step for the
    eigenvalue 3/8 + cos(x) / 4, x = pi / size, has a = -cos(x) cot(x / 2) / (1 + 2 cos(x)) at its ends. A single face
    has no other arm; there the tangent is the sum of the two, with the eigenvalue 1/4.
    """
    x = np.pi / size
    return np.where(size == 1, 1.0, -np.cos(x) / np.tan(x / 2) / (1 + 2 * np.cos(x)))


def _by_angles(mesh: Topology, limit: F64, sectors: Sectors) -> F64:
    """(S, 3) the unit normals of the triangles between limit points, summed over sectors by their angles."""
    p = limit[mesh.faces]
    normal = unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    out = np.zeros((len(sectors.vertices), 3))
    for k in range(3):
        a, b = unit(p[:, (k + 1) % 3] - p[:, k]), unit(p[:, (k + 2) % 3] - p[:, k])
        angle = 2 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
        out += _summed(sectors.corners[:, k], normal * angle[:, None], len(out))
    return out


def _summed(group: I64, terms: F64, n: int) -> F64:
    """(n, 3) sums of terms (N, 3) by their group (N,)."""
    return np.column_stack([np.bincount(group, terms[:, k], n) for k in range(3)])


def unit(vectors: F64) -> F64:
    """Vectors (N, 3) at length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
