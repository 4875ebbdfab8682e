"""The exact surface: each DHF triangulated as a closed solid, and the solids intersected.

A DHF's plane is divided into right triangles by bisection, finely where a height bends and coarsely where it is flat
(right-triangulated irregular networks; Evans, Kirkpatrick and Townsend, 2001). Where the heights cross, triangles are
cut at the silhouette far = near, which the near and the far surface share; at the edge of the domain box walls close
the solid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...arrays import F32, F64, I64, Mask
from ...errors import OptionError, SurfaceError, require
from ..limits import Limits
from .field import Dhf

# Of an error asked for, what the triangulation may take; what the simplification of the result may take is the rest.
# At equal error, triangles that are fine first and simplified then are fewer than those that are coarse at once.
TRIANGULATION = 1 / 3
FINEST = 5e-5  # triangulation error (normalised) below which 2^10 cells a side are looked at, and not 2^9
# For a number of triangles: bisected edges a triangle of the result, at first and at last, and how far the intersection
# is then simplified (in errors of the triangulation) before a coarser triangulation is tried.
BISECTED, FEWEST = 2.5, 0.02
SIMPLIFIED = 8.0
SILHOUETTE_STEPS = 16  # of bisection, along an edge that the silhouette crosses
THINNEST = 1e-12  # a solid of less volume (normalised) is taken as a failure


def intersection(dhfs: Sequence[Dhf], error: float | None, faces: int | None, limits: Limits) -> tuple[F64, I64]:
    """The solid's surface: vertices (N, 3) of the normalised frame and triangles (M, 3), closed and facing outward.

    error: distance from the exact surface, normalised units. It is met but for features smaller than a cell of a grid
    of 512 or 1024 cells over each DHF's domain. faces: in place of it, the most triangles.
    limits: of vertices, for each DHF and for the intersection before it is simplified.
    Raises SurfaceError when manifold3d reports a failure, a solid is empty or has too many vertices, or simplification
    changes its volume; and OptionError for too few faces.
    """
    manifold3d = require("manifold3d", "mesh")
    if error is not None:
        limit = error * TRIANGULATION
        planes = [Plane(dhf, 9 if limit > FINEST else 10) for dhf in dhfs]
        whole = _intersected(manifold3d, planes, limit, limits)
        out = whole.simplify(error * (1 - TRIANGULATION))
        if abs(out.volume() - whole.volume()) > error * whole.surface_area():
            raise SurfaceError("simplification changes its volume")
    else:
        assert faces is not None
        out = _with_faces(manifold3d, [Plane(dhf, 9) for dhf in dhfs], faces, limits)
    _check(manifold3d, out, "the simplified intersection")
    mesh = out.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def _intersected(manifold3d: Any, planes: Sequence[Plane], limit: float, limits: Limits) -> Any:
    """The intersection of the DHFs, each triangulated to the error `limit`, as a Manifold. Raises SurfaceError."""
    parts = []
    for i, plane in enumerate(planes):
        vertices, triangles = plane.solid(limit)
        if not len(triangles):
            raise SurfaceError(f"double height field {i} is empty")
        limits.count("vertices", len(vertices))
        part = manifold3d.Manifold(manifold3d.Mesh64(vertices, triangles.astype(np.uint64)))
        _check(manifold3d, part, f"double height field {i}")
        parts.append(part)
    # As an original, so that the curves where surfaces that nearly coincide weave through one another simplify too.
    whole = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Intersect).as_original()
    _check(manifold3d, whole, "the intersection")
    limits.count("vertices", whole.num_vert())
    return whole


def _with_faces(manifold3d: Any, planes: Sequence[Plane], faces: int, limits: Limits) -> Any:
    """The intersection, simplified by as little as leaves at most `faces` triangles. Raises OptionError."""
    errors = np.sort(np.concatenate([plane.errors.ravel() for plane in planes]))[::-1]
    bisected = BISECTED
    while bisected > FEWEST:
        limit = max(float(errors[min(int(bisected * faces), len(errors) - 1)]), 1e-6)
        whole = _intersected(manifold3d, planes, limit, limits)
        tolerance = limit / 4
        while tolerance < SIMPLIFIED * limit:
            out = whole.simplify(tolerance)
            if out.num_tri() <= faces:
                if out.volume() > whole.volume() / 2:
                    return out
                break
            tolerance *= 1.1 if out.num_tri() < 1.5 * faces else 1.4
        bisected /= 2
    raise OptionError(f"faces is {faces}: too few for this shape")


def volume(vertices: F64, faces: I64) -> float:
    """Of a closed mesh."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def area(vertices: F64, faces: I64) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _check(manifold3d: Any, solid: Any, name: str) -> None:
    if solid.status() != manifold3d.Error.NoError:
        raise SurfaceError(f"manifold3d refuses {name} ({solid.status().name})")
    if not solid.volume() > THINNEST:
        raise SurfaceError(f"{name} has no volume")


class Plane:
    """The heights of a DHF at the (2^levels + 1)^2 nodes of a grid over its domain."""

    def __init__(self, dhf: Dhf, levels: int) -> None:
        n = 2**levels
        lo, hi = dhf.bounds[:2, 0], dhf.bounds[:2, 1]
        u, v = (np.linspace(lo[k], hi[k], n + 1, dtype=np.float32) for k in range(2))
        self.dhf = dhf
        self.uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        heights = _heights(dhf, self.uv)
        self.heights = np.ascontiguousarray(heights.T)
        self.errors = _nested(_interpolation_errors(self.heights.reshape(2, n + 1, n + 1), (hi - lo) / n))

    def solid(self, error: float) -> tuple[F64, I64]:
        """The DHF as a closed mesh: vertices (N, 3) of the normalised frame, triangles (M, 3) facing outward."""
        return _closed(self.dhf, self.uv, self.heights, bisected(self.errors, error))


def _heights(dhf: Dhf, uv: F32) -> F32:
    """(N, 2) near and far height, cut off at the domain box."""
    heights = dhf.heights(uv)
    lo, hi = dhf.bounds[2]
    np.maximum(heights[:, 0], lo, out=heights[:, 0])
    np.minimum(heights[:, 1], hi, out=heights[:, 1])
    return heights


def _interpolation_errors(heights: F32, step: F32) -> F32:
    """(n + 1, n + 1): how far from the surface the middle of the edge that each node bisects would lie.

    The vertical distance, times the cosine of the surface's slope; the larger one of both heights. 0 outside the
    silhouette.
    """
    n = heights.shape[1] - 1
    cosine = [1 / np.sqrt(1 + sum(g**2 for g in np.gradient(h, *step))) for h in heights]
    gap = heights[1] - heights[0]
    out = np.zeros((n + 1, n + 1), dtype=np.float32)

    def own(mid: tuple[slice, slice], a: tuple[slice, slice], b: tuple[slice, slice]) -> None:
        inside = np.maximum(np.maximum(gap[mid], gap[a]), gap[b]) >= 0
        for h, c in zip(heights, cosine, strict=True):
            error = np.abs(h[mid] - (h[a] + h[b]) / 2) * c[mid]
            np.maximum(out[mid], error * inside, out=out[mid])

    for s in (2**k for k in range(n.bit_length() - 1)):
        even, odd = slice(0, n + 1, 2 * s), slice(s, n, 2 * s)
        before, after = slice(0, n - s, 2 * s), slice(2 * s, n + 1, 2 * s)
        own((odd, even), (before, even), (after, even))
        own((even, odd), (even, before), (even, after))
        # The middles of squares; their diagonals alternate.
        for i in range(2):
            for j in range(2):
                rows, columns = slice(s + 2 * s * i, n, 4 * s), slice(s + 2 * s * j, n, 4 * s)
                low = [slice(x.start - s, n - s, 4 * s) for x in (rows, columns)]
                high = [slice(x.start + s, n + 1, 4 * s) for x in (rows, columns)]
                if i == j:
                    own((rows, columns), (low[0], low[1]), (high[0], high[1]))
                else:
                    own((rows, columns), (low[0], high[1]), (high[0], low[1]))
    return out


def _nested(errors: F32) -> F32:
    """Errors raised to those of the edges that come of a node's triangles: no edge is bisected after them."""
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
    """errors at (i, j) + step * (k, l) raised to those at these nodes plus (di, dj), where there are such."""
    n = errors.shape[0]
    rows, columns = np.arange(i, n, step), np.arange(j, n, step)
    rows = rows[(rows + di >= 0) & (rows + di < n)]
    columns = columns[(columns + dj >= 0) & (columns + dj < n)]
    here = np.ix_(rows, columns)
    errors[here] = np.maximum(errors[here], errors[np.ix_(rows + di, columns + dj)])


def bisected(errors: F32, limit: float) -> I64:
    """Triangles (M, 3) of node numbers: those of bisection until no edge's middle has an error above the limit.

    errors: (n + 1, n + 1) at the middles of the edges, n a power of two, and nested: so the triangles fit together.
    """
    n = errors.shape[0] - 1
    split = errors.ravel() > limit
    corner = [0, n, n * (n + 1), n * (n + 2)]
    triangles = np.array([[corner[3], corner[0], corner[2]], [corner[0], corner[3], corner[1]]])
    done = []
    for _ in range(2 * (n.bit_length() - 1)):
        go_on = split[(triangles[:, 0] + triangles[:, 1]) // 2]  # the edge between these is the longest
        done.append(triangles[~go_on])
        a, b, c = triangles[go_on].T
        middle = (a + b) // 2
        triangles = np.concatenate([np.column_stack([c, a, middle]), np.column_stack([b, c, middle])])
    return np.concatenate([*done, triangles])


def _closed(dhf: Dhf, uv: F32, heights: F32, triangles: I64) -> tuple[F64, I64]:
    """The solid between near and far over the part of the triangles where near <= far."""
    inside = heights[1] >= heights[0]
    count = inside[triangles].sum(axis=1)
    whole = triangles[count == 3]
    # Turned so that the first corner is the one that differs from the other two.
    one, two = _turned(triangles[count == 1], inside, True), _turned(triangles[count == 2], inside, False)
    # The edges that the silhouette crosses, from inside to outside.
    ends = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [1, 0]], two[:, [2, 0]]])
    key, number = np.unique(ends @ np.array([len(uv), 1]), return_inverse=True)
    crossing = np.column_stack(np.divmod(key, len(uv)))

    used = np.unique(np.concatenate([whole.ravel(), one[:, 0], two[:, 1], two[:, 2]]).astype(np.int64))
    place = np.zeros(len(uv), dtype=np.int64)
    place[used] = np.arange(len(used))
    cut = 2 * len(used) + number.ravel()
    k = len(one), len(two)
    one_b, one_c, two_b, two_c = np.split(cut, np.cumsum([k[0], k[0], k[1]]))
    b, c = place[two[:, 1]], place[two[:, 2]]
    flat = np.concatenate(
        [
            place[whole],
            np.column_stack([place[one[:, 0]], one_b, one_c]),
            np.column_stack([b, c, two_c]),
            np.column_stack([b, two_c, two_b]),
        ]
    )
    near = np.where(flat < len(used), flat + len(used), flat)  # the silhouette belongs to both
    faces = np.concatenate([flat, near[:, ::-1], _walls(flat, near)])

    edge_uv, edge_z = _silhouette(dhf, uv[crossing[:, 0]], uv[crossing[:, 1]])
    vertices = np.concatenate(
        [
            np.column_stack([uv[used], heights[1, used]]),
            np.column_stack([uv[used], heights[0, used]]),
            np.column_stack([edge_uv, edge_z]),
        ]
    ).astype(np.float64)
    return vertices @ dhf.record.rotation, faces


def _turned(triangles: I64, inside: Mask, value: bool) -> I64:
    first = (inside[triangles] == value).argmax(axis=1)
    return np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)


def _walls(far: I64, near: I64) -> I64:
    """Triangles between the boundary edges of the far and of the near surface that do not coincide."""
    edges = np.concatenate([far[:, [0, 1]], far[:, [1, 2]], far[:, [2, 0]]])
    below = np.concatenate([near[:, [0, 1]], near[:, [1, 2]], near[:, [2, 0]]])
    size = int(far.max(initial=0)) + 1
    _, first, times = np.unique(np.sort(edges, axis=1) @ np.array([size, 1]), return_index=True, return_counts=True)
    first = first[times == 1]
    (a, b), (c, d) = edges[first].T, below[first].T
    walls = np.concatenate([np.column_stack([b, a, c]), np.column_stack([b, c, d])])
    return walls[(walls[:, 0] != walls[:, 1]) & (walls[:, 1] != walls[:, 2]) & (walls[:, 2] != walls[:, 0])]


def _silhouette(dhf: Dhf, inside: F32, outside: F32) -> tuple[F32, F32]:
    """Where far = near between points inside and outside (N, 2): (N, 2) and the height (N,) there."""
    a, b = np.zeros(len(inside), dtype=np.float32), np.ones(len(inside), dtype=np.float32)
    t = (a + b) / 2
    for _ in range(SILHOUETTE_STEPS):
        t = (a + b) / 2
        near, far = _heights(dhf, inside + t[:, None] * (outside - inside)).T
        a, b = np.where(far >= near, t, a), np.where(far >= near, b, t)
    uv = inside + t[:, None] * (outside - inside)
    return uv, _heights(dhf, uv).mean(axis=1)
