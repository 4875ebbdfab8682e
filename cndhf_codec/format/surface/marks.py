"""Sharp marks: which interior edges of the control mesh are sharp. Boundary edges always are, and are not coded.

Sharp edges form lines that go on from vertex to vertex. So whenever a vertex has got its first sharp edge, boundaries
included, the line is *followed*: the other edges of the vertex are coded, those opposite to the sharp one first, until
one is sharp. When there is no line to follow, the next edge in order of first appearance in the faces is coded.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ...errors import OptionError
from .manifold import Edges, Ints, edges_of
from .range_coder import Coder, Context, RangeDecoder, RangeEncoder

MAX_LEFT = 4  # contexts distinguish so many edges that are left at the end of a line
MAX_SHARP = 2  # and so many sharp edges of a vertex


def encode_marks(encoder: RangeEncoder, faces: Ints, sharp: Ints) -> None:
    """Code the sharp edges of a mesh.

    Parameters
    ----------
    encoder : RangeEncoder
    faces : (F, 3) int array
        the mesh as it is decoded: renumbered and in the order that `encode_connectivity` has chosen
    sharp : (S, 2) int array
        vertex numbers of interior edges, in any order

    Raises
    ------
    OptionError
        if an edge is not an interior edge of the mesh
    """
    edges = edges_of(faces)
    pairs = np.sort(np.asarray(sharp, dtype=np.int64).reshape(-1, 2), axis=1)
    keys = edges.vertices[:, 0].astype(np.int64) << 32 | edges.vertices[:, 1]
    wanted = pairs[:, 0] << 32 | pairs[:, 1]
    wrong = ~np.isin(wanted, keys[edges.n_faces == 2])
    if wrong.any():
        raise OptionError(
            f"{pairs[np.argmax(wrong)].tolist()} cannot be marked sharp: it is no interior edge of the control mesh"
        )
    _code(encoder, faces, edges, np.isin(keys, wanted))


def decode_marks(decoder: RangeDecoder, faces: Ints) -> Ints:
    """Read the sharp edges of a mesh with faces (F, 3).

    Returns
    -------
    (S, 2) int32 array
        vertex numbers of the sharp interior edges, the smaller one first, in lexicographic order

    Raises
    ------
    TruncatedError
        if the section ends inside
    """
    edges = edges_of(faces)
    return edges.vertices[_code(decoder, faces, edges, np.zeros(len(edges.vertices), dtype=bool))]


def _code(coder: Coder, faces: Ints, edges: Edges, sharp: np.ndarray) -> np.ndarray:
    """Code which edges are sharp, and return it: (E,) bool. A mesh without interior edges takes no bits."""
    interior = edges.n_faces == 2
    if not interior.any() or not coder.bit(Context(), int(sharp.any())):
        return np.zeros_like(interior)
    if coder.bit(Context(), int(sharp[interior].all())):
        return interior
    marks = _Marks(coder, faces, edges, sharp.tolist())
    marks.run()
    return np.array(marks.sharp, dtype=bool) & interior


class _Marks:
    """The state of coding, which goes the same way in encoder and decoder."""

    def __init__(self, coder: Coder, faces: Ints, edges: Edges, wanted: list[bool]) -> None:
        self._coder = coder
        self._wanted = wanted  # what an encoder codes; a decoder's is ignored
        self._ends: list[list[int]] = edges.vertices.tolist()
        self._todo: list[bool] = (edges.n_faces == 2).tolist()
        self.sharp: list[bool] = (edges.n_faces == 1).tolist()
        n_vertices = int(faces.max()) + 1
        ends = edges.vertices
        self._n_sharp: list[int] = np.bincount(ends[edges.n_faces == 1].ravel(), minlength=n_vertices).tolist()
        self._left: list[int] = np.bincount(ends[edges.n_faces == 2].ravel(), minlength=n_vertices).tolist()
        self._order: list[int] = np.argsort(np.unique(edges.of_faces, return_index=True)[1]).tolist()
        # Per vertex, the two edges that meet there in each of its faces.
        self._corners: list[list[tuple[int, int]]] = [[] for _ in range(n_vertices)]
        for (a, b, c), (ab, bc, ca) in zip(faces.tolist(), edges.of_faces.tolist(), strict=True):
            self._corners[a].append((ab, ca))
            self._corners[b].append((bc, ab))
            self._corners[c].append((ca, bc))
        self._lines: deque[int] = deque(v for v in range(n_vertices) if self._n_sharp[v] == 1)
        # Following, by edges left and by sharp edges at the other end; else, by sharp edges at both ends.
        self._follow = [[Context() for _ in range(MAX_SHARP + 1)] for _ in range(MAX_LEFT + 1)]
        self._start = [[Context() for _ in range(MAX_SHARP + 1)] for _ in range(MAX_SHARP + 1)]

    def run(self) -> None:
        """Code all edges."""
        n_sharp = self._n_sharp
        for edge in self._order:
            while self._lines:
                self._follow_line(self._lines.popleft())
            if self._todo[edge]:
                a, b = (min(n_sharp[v], MAX_SHARP) for v in self._ends[edge])
                self._mark(edge, self._start[min(a, b)][max(a, b)])

    def _follow_line(self, v: int) -> None:
        """Code the edges of a vertex with one sharp edge, the opposite ones first, until another is sharp."""
        if self._n_sharp[v] > 1:
            return
        for edge in self._opposite_first(v):
            if self._todo[edge] and self._n_sharp[v] == 1:
                a, b = self._ends[edge]
                other = self._n_sharp[a + b - v]
                self._mark(edge, self._follow[min(self._left[v], MAX_LEFT)][min(other, MAX_SHARP)])

    def _opposite_first(self, v: int) -> list[int]:
        """The edges of a vertex by their distance in its fan from a sharp one, farthest first; equals by number."""
        beside: dict[int, list[int]] = {}
        for a, b in self._corners[v]:
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
        ring = [edge for edge in beside if self.sharp[edge]]
        seen, rings = set(ring), []
        while ring:
            rings.append(sorted(ring))
            ring = list({e for edge in ring for e in beside[edge] if e not in seen})
            seen.update(ring)
        return [edge for ring in reversed(rings) for edge in ring]

    def _mark(self, edge: int, context: Context) -> None:
        """Code one edge."""
        self._todo[edge] = False
        mark = self._coder.bit(context, int(self._wanted[edge]))
        for v in self._ends[edge]:
            self._left[v] -= 1
            if mark:
                self._n_sharp[v] += 1
                if self._n_sharp[v] == 1:
                    self._lines.append(v)
        self.sharp[edge] = bool(mark)
