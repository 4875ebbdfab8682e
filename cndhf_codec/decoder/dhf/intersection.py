"""A surface with sharp creases: each DHF triangulated as a closed solid, and the solids intersected.

A DHF's domain is divided into right triangles by bisection, finely where a height bends and coarsely where it is flat
(right-triangulated irregular networks; Evans, Kirkpatrick and Townsend, 2001). Where the heights cross, triangles are
cut at the silhouette far = near, which the near and the far side share. Walls close the solid at the domain's edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...arrays import F32, I64, Mask
from ...errors import SurfaceError, require
from ..limits import Limits
from ..results import TriangleMesh
from .field import Dhf

# Evidence for these constants: ADR 030.
#
# Share of an error bound that goes to the triangulation; the rest goes to simplifying the intersection. At equal error,
# a fine triangulation that is simplified has fewer triangles than a coarse one.
TRIANGULATION_SHARE = 1 / 3
# Levels of bisection: a grid of 2^levels cells per side is sampled. The fine one is for triangulation errors up to
# FINE_ERROR (normalised units).
LEVELS, FINE_LEVELS, FINE_ERROR = 9, 10, 5e-5
SILHOUETTE_STEPS = 16  # of bisection, along an edge that the silhouette crosses
MIN_VOLUME = 1e-12  # a solid of less volume (normalised units) is taken as a failure


def intersection(dhfs: Sequence[Dhf], error: float, limits: Limits) -> TriangleMesh:
    """The solid's surface, closed and facing outward, in the normalised frame.

    error: the greatest distance from the exact surface, normalised units. Features may be missed that are smaller than
    a cell, with 512 or 1024 cells per side of a DHF's domain. limits: of vertices, for each DHF and for the
    intersection before it is simplified.
    Raises SurfaceError when manifold3d reports a failure, a solid is empty or has too many vertices, or simplification
    changes its volume.
    """
    manifold3d = require("manifold3d", "mesh")
    limit = error * TRIANGULATION_SHARE
    levels = LEVELS if limit > FINE_ERROR else FINE_LEVELS
    whole = _intersected(manifold3d, [DhfTriangulation(dhf, levels) for dhf in dhfs], limit, limits)
    out = whole.simplify(error * (1 - TRIANGULATION_SHARE))
    if abs(out.volume() - whole.volume()) > error * whole.surface_area():
        raise SurfaceError("simplification changes its volume")
    _check(manifold3d, out, "the simplified intersection")
    mesh = out.to_mesh64()
    return TriangleMesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64))


def _intersected(manifold3d: Any, triangulations: Sequence[DhfTriangulation], limit: float, limits: Limits) -> Any:
    """The intersection of the DHFs, each triangulated to the error `limit`, as a Manifold. Raises SurfaceError."""
    parts = []
    for i, triangulation in enumerate(triangulations):
        vertices, faces = triangulation.solid(limit)
        if not len(faces):
            raise SurfaceError(f"double height field {i} is empty")
        limits.count("vertices", len(vertices))
        part = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
        _check(manifold3d, part, f"double height field {i}")
        parts.append(part)
    # manifold3d does not simplify edges between faces of different originals. Where surfaces nearly coincide, there are
    # many of these: as one original they are simplified, too.
    whole = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Intersect).as_original()
    _check(manifold3d, whole, "the intersection")
    limits.count("vertices", whole.num_vert())
    return whole


def volume(mesh: TriangleMesh) -> float:
    """Volume of a closed mesh."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def area(mesh: TriangleMesh) -> float:
    """Area of a mesh."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _check(manifold3d: Any, solid: Any, name: str) -> None:
    """Raise SurfaceError when manifold3d has refused a solid, or it has no volume."""
    if solid.status() != manifold3d.Error.NoError:
        raise SurfaceError(f"manifold3d refuses {name} ({solid.status().name})")
    if not solid.volume() > MIN_VOLUME:
        raise SurfaceError(f"{name} has no volume")


class DhfTriangulation:
    """Triangulations of a DHF to any error, by bisection of a grid of 2^levels cells per side over its domain.

    errors: (2^levels + 1, 2^levels + 1) normalised units; a node is used where its error is above that asked for.
    """

    def __init__(self, dhf: Dhf, levels: int) -> None:
        n = 2**levels
        lo, hi = dhf.bounds[:2, 0], dhf.bounds[:2, 1]
        u, v = (np.linspace(lo[k], hi[k], n + 1, dtype=np.float32) for k in range(2))
        self.dhf = dhf
        self.uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        heights = _clipped_heights(dhf, self.uv)
        self.heights = np.ascontiguousarray(heights.T)
        self.errors = _nested(_interpolation_errors(self.heights.reshape(2, n + 1, n + 1), (hi - lo) / n))

    def solid(self, error: float) -> TriangleMesh:
        """The DHF's own solid as a mesh, closed and facing outward, in the normalised frame; without faces if empty."""
        return _closed(self.dhf, self.uv, self.heights, bisected(self.errors, error))


def _clipped_heights(dhf: Dhf, uv: F32) -> F32:
    """Near and far height at (N, 2), cut off at the domain box, (N, 2)."""
    heights = dhf.heights(uv)
    lo, hi = dhf.bounds[2]
    np.maximum(heights[:, 0], lo, out=heights[:, 0])
    np.minimum(heights[:, 1], hi, out=heights[:, 1])
    return heights


def _interpolation_errors(heights: F32, step: F32) -> F32:
    """(n + 1, n + 1): for each node, the distance from the surface of the middle of the edge that it bisects.

    heights: (2, n + 1, n + 1). The distance is taken along z, times the cosine of the surface's slope; of near and far
    height, the larger. 0 where the edge and its middle lie outside the silhouette.
    """
    n = heights.shape[1] - 1
    cosine = [1 / np.sqrt(1 + sum(g**2 for g in np.gradient(h, *step))) for h in heights]
    gap = heights[1] - heights[0]
    out = np.zeros((n + 1, n + 1), dtype=np.float32)

    def measure(mid: tuple[slice, slice], a: tuple[slice, slice], b: tuple[slice, slice]) -> None:
        inside = np.maximum(np.maximum(gap[mid], gap[a]), gap[b]) >= 0
        for h, c in zip(heights, cosine, strict=True):
            error = np.abs(h[mid] - (h[a] + h[b]) / 2) * c[mid]
            np.maximum(out[mid], error * inside, out=out[mid])

    for s in (2**k for k in range(n.bit_length() - 1)):
        even, odd = slice(0, n + 1, 2 * s), slice(s, n, 2 * s)
        before, after = slice(0, n - s, 2 * s), slice(2 * s, n + 1, 2 * s)
        measure((odd, even), (before, even), (after, even))
        measure((even, odd), (even, before), (even, after))
        # The middles of squares; their diagonals alternate.
        for i in range(2):
            for j in range(2):
                rows, columns = slice(s + 2 * s * i, n, 4 * s), slice(s + 2 * s * j, n, 4 * s)
                low = [slice(x.start - s, n - s, 4 * s) for x in (rows, columns)]
                high = [slice(x.start + s, n + 1, 4 * s) for x in (rows, columns)]
                if i == j:
                    measure((rows, columns), (low[0], low[1]), (high[0], high[1]))
                else:
                    measure((rows, columns), (low[0], high[1]), (high[0], low[1]))
    return out


def _nested(errors: F32) -> F32:
    """Raise each node's error to those of the nodes that bisect its triangles' other edges.

    So a node is never left out while one of these is used, and the triangles fit together without gaps.
    """
    n = errors.shape[0] - 1
    for s in (2**k for k in range(n.bit_length() - 1)):
        if s > 1:
            d = s // 2
            for i, j in ((s, 0), (0, s)):
                for di, dj in ((-d, -d), (-d, d), (d, -d), (d, d)):
                    _raise(errors, i, j, di, dj, 2 * s)
        for di, dj in ((-s, 0), (s, 0), (0, -s), (0, s)):
            _raise(errors, s, s, di, dj, 2 * s)
    return errors


def _raise(errors: F32, i: int, j: int, di: int, dj: int, step: int) -> None:
    """Raise errors at nodes (i, j) + step * (k, l) to those at the nodes (di, dj) from them, where these exist."""
    n = errors.shape[0]
    rows, columns = np.arange(i, n, step), np.arange(j, n, step)
    rows = rows[(rows + di >= 0) & (rows + di < n)]
    columns = columns[(columns + dj >= 0) & (columns + dj < n)]
    here = np.ix_(rows, columns)
    errors[here] = np.maximum(errors[here], errors[np.ix_(rows + di, columns + dj)])


def bisected(errors: F32, limit: float) -> I64:
    """Triangles (M, 3) of node numbers, from bisection until no edge's middle has an error above the limit.

    errors: (n + 1, n + 1) from `_nested`, n a power of two.
    """
    n = errors.shape[0] - 1
    split = errors.ravel() > limit
    corner = [0, n, n * (n + 1), n * (n + 2)]
    triangles = np.array([[corner[3], corner[0], corner[2]], [corner[0], corner[3], corner[1]]])
    done = []
    for _ in range(2 * (n.bit_length() - 1)):
        divide = split[(triangles[:, 0] + triangles[:, 1]) // 2]  # the edge between the first two is the longest
        done.append(triangles[~divide])
        a, b, c = triangles[divide].T
        middle = (a + b) // 2
        triangles = np.concatenate([np.column_stack([c, a, middle]), np.column_stack([b, c, middle])])
    return np.concatenate([*done, triangles])


def _closed(dhf: Dhf, uv: F32, heights: F32, triangles: I64) -> TriangleMesh:
    """The solid between near and far height, over the part of the triangles where near <= far.

    uv: (N, 2) and heights: (2, N) at all nodes. triangles: (M, 3) numbers of nodes.
    """
    inside = heights[1] >= heights[0]
    corners_inside = inside[triangles].sum(axis=1)
    whole = triangles[corners_inside == 3]
    # Triangles that the silhouette cuts, with one or two corners inside. The first corner differs from the other two.
    one = _rolled(triangles[corners_inside == 1], inside, True)
    two = _rolled(triangles[corners_inside == 2], inside, False)
    # Their cut edges, from inside to outside: from corner 0 to 1 and 0 to 2, and to 0 from 1 and from 2.
    ends = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [1, 0]], two[:, [2, 0]]])
    key, number = np.unique(ends @ np.array([len(uv), 1]), return_inverse=True)
    cut_edges = np.column_stack(np.divmod(key, len(uv)))

    # Vertices in their order: far heights of the nodes used, near heights of these, silhouette points of the cut edges.
    used = np.unique(np.concatenate([whole.ravel(), one[:, 0], two[:, 1], two[:, 2]]).astype(np.int64))
    place = np.zeros(len(uv), dtype=np.int64)
    place[used] = np.arange(len(used))
    silhouette = 2 * len(used) + number.ravel()
    one_b, one_c, two_b, two_c = np.split(silhouette, np.cumsum([len(one), len(one), len(two)]))
    b, c = place[two[:, 1]], place[two[:, 2]]
    far = np.concatenate(
        [
            place[whole],
            np.column_stack([place[one[:, 0]], one_b, one_c]),
            np.column_stack([b, c, two_c]),
            np.column_stack([b, two_c, two_b]),
        ]
    )
    near = np.where(far < len(used), far + len(used), far)  # both sides share the silhouette
    faces = np.concatenate([far, near[:, ::-1], _walls(far, near)])

    edge_uv, edge_z = _silhouette(dhf, uv[cut_edges[:, 0]], uv[cut_edges[:, 1]])
    vertices = np.concatenate(
        [
            np.column_stack([uv[used], heights[1, used]]),
            np.column_stack([uv[used], heights[0, used]]),
            np.column_stack([edge_uv, edge_z]),
        ]
    ).astype(np.float64)
    return TriangleMesh(vertices @ dhf.record.rotation, faces)


def _rolled(triangles: I64, inside: Mask, value: bool) -> I64:
    """Roll the corners of each triangle until the first one for which `inside` is `value` comes first."""
    first = (inside[triangles] == value).argmax(axis=1)
    return np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)


def _walls(far: I64, near: I64) -> I64:
    """Triangles that join the boundary edges of the far side to those of the near side, where these are apart.

    far, near: (M, 3) triangles of both sides, in the same order.
    """
    edges = np.concatenate([far[:, [0, 1]], far[:, [1, 2]], far[:, [2, 0]]])
    below = np.concatenate([near[:, [0, 1]], near[:, [1, 2]], near[:, [2, 0]]])
    size = int(far.max(initial=0)) + 1
    _, first, times = np.unique(np.sort(edges, axis=1) @ np.array([size, 1]), return_index=True, return_counts=True)
    first = first[times == 1]
    (a, b), (c, d) = edges[first].T, below[first].T
    walls = np.concatenate([np.column_stack([b, a, c]), np.column_stack([b, c, d])])
    return walls[(walls[:, 0] != walls[:, 1]) & (walls[:, 1] != walls[:, 2]) & (walls[:, 2] != walls[:, 0])]


def _silhouette(dhf: Dhf, inside: F32, outside: F32) -> tuple[F32, F32]:
    """Points (N, 2) where far = near between `inside` and `outside` (N, 2), and heights (N,) there, by bisection."""
    a, b = np.zeros(len(inside), dtype=np.float32), np.ones(len(inside), dtype=np.float32)
    t = (a + b) / 2
    for _ in range(SILHOUETTE_STEPS):
        t = (a + b) / 2
        near, far = _clipped_heights(dhf, inside + t[:, None] * (outside - inside)).T
        a, b = np.where(far >= near, t, a), np.where(far >= near, b, t)
    uv = inside + t[:, None] * (outside - inside)
    return uv, _clipped_heights(dhf, uv).mean(axis=1)
