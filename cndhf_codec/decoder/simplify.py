"""Simplify a mesh by edge collapses, many at a time, measured by quadrics.

Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics" (1997): a vertex carries the sum of squared
distances from the planes of the faces that it stands for, weighted by their areas, and a collapse puts the new vertex
where the sum for both is least. In each round all edges collapse that are the cheapest around them, so that numpy does
a round at once. No two of them share a face, so a closed mesh stays closed; the rim of an open one stays as it is.
"""

from __future__ import annotations

import numpy as np

from ..arrays import F64, I64, Mask
from ..errors import OptionError
from .results import TriangleMesh

# Evidence for these constants: ADR 040.
# Part of the quadric that holds a vertex where it is: it decides only where planes do not, in flat places.
HOLD = 1e-8
LEAST_COSINE = 0.2  # a face may turn by up to 78 degrees in one collapse; beyond it would soon fold over
LEAST_FACES = 4  # of a closed mesh
ROUND = 40  # a round collapses at most one edge for so many triangles: cheap ones come before dear ones
PASSES = 2  # choices of edges in a round; the second among those that the first leaves room for


def simplified(mesh: TriangleMesh, tolerance: float = np.inf, faces: int = LEAST_FACES) -> TriangleMesh:
    """Simplify a mesh as far as a tolerance or a number of triangles allows, whichever comes first.

    Parameters
    ----------
    mesh : TriangleMesh
        Edges that have not just two faces, or two that disagree in orientation, stay as they are.
    tolerance : float
        The root mean square distance of a vertex from the planes of the triangles that it stands for, at most; in the
        mesh's units.
    faces : int
        The triangles at which it stops, 4 or more.

    Returns
    -------
    TriangleMesh
        With the topology of the mesh, which may ask for more triangles than `faces`.

    Examples
    --------
    >>> import cndhf_codec
    >>> from cndhf_codec.decoder.simplify import simplified
    >>> mesh = cndhf_codec.load("tests/golden/encoded.cndhf").surface(32)
    >>> len(simplified(mesh, faces=500).faces)
    500
    """
    work = _Work(mesh)
    while (left := len(work.faces)) > faces and work.round(tolerance, min((left - faces + 1) // 2, left // ROUND + 1)):
        pass
    work.compact()
    return TriangleMesh(work.vertices, work.faces)


def with_faces(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    """Simplify a mesh to at most so many triangles. Raises OptionError where its topology asks for more."""
    out = simplified(mesh, faces=faces)
    if len(out.faces) > faces:
        raise OptionError(f"faces is {faces}: too few for this shape; {len(out.faces)} are enough")
    return out


class _Work:
    """The mesh while it is simplified. costs: (M, 3) of the edge from each corner of each face to the next; infinite
    where it goes from the higher to the lower vertex, for its other face has it, and where it must not collapse."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.vertices, self.faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
        self._quadrics, self._areas = _quadrics(self.vertices, self.faces)
        self._kept = _irregular(self.faces, len(self.vertices))
        self._costs = np.full(self.faces.shape, np.inf)
        self._update(np.ones(self.faces.shape, dtype=bool))

    def round(self, tolerance: float, most: int) -> int:
        """Collapse at most `most` edges; return how many were looked at, 0 where none is left within the tolerance."""
        costs = self._costs.ravel()
        at = np.flatnonzero(costs < np.inf)
        if tolerance < np.inf:
            first, second = self._ends(at)
            at = at[costs[at] <= tolerance**2 * (self._areas[first] + self._areas[second])]
        at = at[np.argsort(costs[at], kind="stable")]
        at = self._apart(at)
        allowed = at[self._allowed(at)][:most]
        if len(allowed):
            self._collapse(allowed)
            if len(self.vertices) > len(self.faces):  # half of them are used
                self.compact()
        return len(at)

    def compact(self) -> None:
        """Leave out vertices that no face has any more."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        self.faces = (np.cumsum(used) - 1)[self.faces]
        self.vertices, self._quadrics = self.vertices[used], self._quadrics[:, used]
        self._areas, self._kept = self._areas[used], self._kept[used]

    def _ends(self, at: I64) -> tuple[I64, I64]:
        face, corner = np.divmod(at, 3)
        return self.faces[face, corner], self.faces[face, (corner + 1) % 3]

    def _update(self, which: Mask) -> None:
        """Compute the costs (M, 3) of some edges."""
        at = np.flatnonzero(which)
        first, second = self._ends(at)
        ahead = (first < second) & ~self._kept[first] & ~self._kept[second]
        costs = np.full(len(at), np.inf)
        a, b = first[ahead], second[ahead]
        costs[ahead] = _best(self._quadrics[:, a] + self._quadrics[:, b], self.vertices[a], self.vertices[b])[1]
        self._costs.ravel()[at] = costs

    def _apart(self, at: I64) -> I64:
        """Those of these edges, cheapest first, that are the cheapest around them: no face has vertices of two."""
        chosen = []
        for _ in range(PASSES):
            first, second = self._ends(at)
            order, none = np.arange(len(at)), len(at)
            near = np.full(len(self.vertices), none)
            near[second[::-1]] = order[::-1]  # of several edges at a vertex, the last written is the cheapest
            at_first = np.full(len(self.vertices), none)
            at_first[first[::-1]] = order[::-1]
            np.minimum(near, at_first, out=near)
            least = self._over_neighbours(np.minimum, near)
            alone = (least[first] == order) & (least[second] == order)
            chosen.append(at[alone])
            taken = np.zeros(len(self.vertices), dtype=bool)
            taken[first[alone]] = taken[second[alone]] = True
            taken = self._over_neighbours(np.logical_or, taken)
            at = at[~(taken[first] | taken[second])]
        found = np.concatenate(chosen)
        return found[np.argsort(self._costs.ravel()[found], kind="stable")]

    def _over_neighbours(self, least: np.ufunc, values: np.ndarray) -> np.ndarray:
        """(N,) the least, or any, of the values of a vertex and its neighbours."""
        x, y, z = (values[corner] for corner in self.faces.T)
        around = least(least(x, y), z)
        out = values.copy()
        for corner in self.faces.T:
            least.at(out, corner, around)
        return out

    def _allowed(self, at: I64) -> Mask:
        """Which of these edges, of no common face, collapse without folding a face over and without new topology."""
        first, second = self._ends(at)
        number = np.full(len(self.vertices), -1)
        number[first] = number[second] = np.arange(len(at))
        is_second = np.zeros(len(self.vertices), dtype=bool)
        is_second[second] = True
        # Each vertex around the edge is a neighbour of one end, but for two of both, across the two faces that go.
        own = number[self.faces]
        face, corner = np.nonzero(own >= 0)
        of, other = own[face, corner], self.faces[face, (corner + 1) % 3]
        outside = own[face, (corner + 1) % 3] < 0
        key = np.sort(of[outside] * len(self.vertices) + other[outside])
        shared = np.bincount(key[1:][key[1:] == key[:-1]] // len(self.vertices), minlength=len(at))
        degree = np.bincount(of, minlength=len(at))  # of both ends together; 6 of a tetrahedron
        good = (shared == 2) & (degree > 6)
        position = self._positions(first, second)
        face = np.flatnonzero((own >= 0).sum(axis=1) == 1)
        of = own[face].max(axis=1)
        corners = self.vertices[self.faces[face]]
        before = _normals(corners)
        moved = np.where((own[face] >= 0)[:, :, None], position[of][:, None, :], corners)
        after = _normals(moved)
        cosine = (before * after).sum(axis=1)
        size = np.sqrt((before**2).sum(axis=1) * (after**2).sum(axis=1))
        good[of[~(cosine > LEAST_COSINE * size)]] = False
        # What is refused now is not looked at again until something changes there.
        self._costs.ravel()[at[~good]] = np.inf
        return good

    def _positions(self, first: I64, second: I64) -> F64:
        return _best(self._quadrics[:, first] + self._quadrics[:, second], self.vertices[first], self.vertices[second])[
            0
        ]

    def _collapse(self, at: I64) -> None:
        first, second = self._ends(at)
        self.vertices[first] = self._positions(first, second)
        self._quadrics[:, first] += self._quadrics[:, second]
        self._areas[first] += self._areas[second]
        onto = np.arange(len(self.vertices))
        onto[second] = first
        self.faces = onto[self.faces]
        a, b, c = self.faces.T
        alive = (a != b) & (b != c) & (c != a)
        self.faces, self._costs = self.faces[alive], self._costs[alive]
        changed = np.zeros(len(self.vertices), dtype=bool)
        changed[first] = True
        near = changed[self.faces]
        # Edges across from a changed vertex have their cost, unless they were refused.
        beside = np.asarray(near.any(axis=1))[:, None]
        again = near | near[:, [1, 2, 0]] | (beside & (self._costs == np.inf))
        self._update(again)


def _irregular(faces: I64, n_vertices: int) -> Mask:
    """(N,) whether a vertex lies on an edge of the boundary, of several pairs of faces, or of two that disagree in
    orientation: such are kept."""
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    key, of, count = np.unique(
        np.minimum(start, end) * n_vertices + np.maximum(start, end), return_inverse=True, return_counts=True
    )
    odd = key[(count != 2) | (np.bincount(of, start < end) != 1)]
    out = np.zeros(n_vertices, dtype=bool)
    out[odd // n_vertices] = True
    out[odd % n_vertices] = True
    return out


def _normals(corners: F64) -> F64:
    """(M, 3) normals of triangles (M, 3, 3), twice as long as their areas."""
    x, y = (corners[:, k] - corners[:, 0] for k in (1, 2))
    # As np.cross, which takes several times as long.
    return np.stack([x[:, i] * y[:, j] - x[:, j] * y[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)


def _quadrics(vertices: F64, faces: I64) -> tuple[F64, F64]:
    """(10, N) xx xy xz yy yz zz x y z 1 of every vertex, and (N,) the areas that they stand for."""
    corners = vertices[faces]
    normal = _normals(corners)
    size = np.sqrt((normal**2).sum(axis=1))
    n: F64 = np.divide(normal, size[:, None], out=np.zeros_like(normal), where=size[:, None] > 0).T
    d = -(n * corners[:, 0].T).sum(axis=0)
    area = size / 2
    at, n_vertices = faces.ravel(), len(vertices)
    area_at = np.bincount(at, np.repeat(area, 3), n_vertices).astype(np.float64)
    parts = [n[0] * n[0], n[0] * n[1], n[0] * n[2], n[1] * n[1], n[1] * n[2], n[2] * n[2], *(n * d), d * d]
    out = np.stack([np.bincount(at, np.repeat(area * part, 3), n_vertices) for part in parts]).astype(np.float64)
    hold = HOLD * area_at
    out[[0, 3, 5]] += hold
    out[6:9] -= hold * vertices.T
    out[9] += hold * (vertices**2).sum(axis=1)
    return out, area_at


def _best(q: F64, a: F64, b: F64) -> tuple[F64, F64]:
    """(N, 3) where quadrics (10, N) are least, and their values there.

    Where that is not known: the middle of a and b, or the one of them, whichever is least. Values below rounding are 0.
    """
    xx, xy, xz, yy, yz, zz, x, y, z, _ = q
    # The inverse by cofactors: symmetric.
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c11, c12, c22 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    det = xx * c00 + xy * c01 + xz * c02
    middle = (a + b).T / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        p = -np.stack([c00 * x + c01 * y + c02 * z, c01 * x + c11 * y + c12 * z, c02 * x + c12 * y + c22 * z]) / det
    # Far from the edge, the planes are nearly parallel and say nothing.
    length = ((a - b) ** 2).sum(axis=1)
    with np.errstate(invalid="ignore"):
        far = np.flatnonzero(~(((p - middle) ** 2).sum(axis=0) <= 4 * length))
    # The middle alone would cut tips off: at the end of a thin leg planes of all its sides meet.
    ends = np.stack([middle[:, far], a[far].T, b[far].T])
    least = np.argmin([_value(q[:, far], end) for end in ends], axis=0)
    p[:, far] = ends[least, :, np.arange(len(far))].T
    return np.ascontiguousarray(p.T), np.maximum(_value(q, p), 0.0)


def _value(q: F64, p: F64) -> F64:
    """(N,) of quadrics (10, N) at points (3, N)."""
    xx, xy, xz, yy, yz, zz, x, y, z, one = q
    out: F64 = (
        p[0] * (xx * p[0] + 2 * (xy * p[1] + xz * p[2] + x))
        + p[1] * (yy * p[1] + 2 * (yz * p[2] + y))
        + p[2] * (zz * p[2] + 2 * z)
        + one
    )
    return out
