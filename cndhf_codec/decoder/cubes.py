"""Marching cubes (Lorensen and Cline, 1987) on the bricks of a narrow band.

scikit-image's works on dense grids: looking at each of their cells takes longer than all that is done here.

The table of cases is made by rule. On each face of a cell, outside corners that lie next to one another are cut off
together from the rest: so inside corners across a face's diagonal are joined, and thin walls hold together. Both cells
of a face do the same, so the surface is closed. No triangle has an edge within a face that the rule did not put
there, so no edge of the surface has more than two triangles.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt

from .band import BRICK, I32, INSIDE, LOCAL, Band
from .parallel import over_rows

I64 = npt.NDArray[np.int64]

# Corner c of a cell is at (c >> 2 & 1, c >> 1 & 1, c & 1). An edge is its lower corner and its axis.
CORNERS = tuple(product((0, 1), repeat=3))
STRIDES = (4, 2, 1)
EDGES = tuple((c, axis) for c in range(8) for axis in range(3) if not CORNERS[c][axis])
Triangle = tuple[int, int, int]
CELLS_AT_ONCE = 2**15

# A brick's nodes and those just above it, (125, 3): whose brick each is (by corner), and its number in it.
PADDED = np.indices((BRICK + 1,) * 3).reshape(3, -1).T
WHOSE = (PADDED // BRICK) @ STRIDES
NUMBER = (PADDED % BRICK) @ (BRICK * BRICK, BRICK, 1)
PADDED_STRIDES = np.array([(BRICK + 1) ** 2, BRICK + 1, 1])
OWN = LOCAL @ PADDED_STRIDES  # (64,) the brick's own nodes in that order
FAR_END = (OWN[:, None] + PADDED_STRIDES).ravel()  # (192,) of the edge 3 * node + axis


def surface_edges(band: Band) -> tuple[I32, I32, I64]:
    """Where the surface crosses the grid, and how the crossings join.

    Returns the nodes (N, 2) at both ends of the grid's edges that it crosses, as 64 * row + node with node 0 to 63 of
    the band's brick in that row; the axes (N,) of those edges; and triangles (M, 3) of their numbers, seen
    anticlockwise from outside.
    """
    row = np.arange(INSIDE + 1, len(band.values))
    # The bricks at a brick's eight corners (0, 0, 0), (0, 0, 1), ...: those that hold the nodes just above it.
    # Bricks last: numpy is fast along long last dimensions.
    steps = np.array(CORNERS, dtype=np.int32).T * BRICK
    beside = band.rows(np.ascontiguousarray(band.corners[row].T)[:, None] + steps[..., None])
    own = band.values >= 0
    # 0 all outside, 1 all inside, 2 both: only a brick that has both, with those beside it, can have a crossing.
    kind = np.where(own.all(axis=1), 1, np.where(own.any(axis=1), 2, 0)).astype(np.int8)[beside]
    both = np.flatnonzero((kind.max(axis=0) == 2) | (kind.min(axis=0) != kind.max(axis=0)))
    row, beside = row[both], beside.take(both, axis=1)
    place = np.zeros(len(band.values), dtype=np.int32)  # of a row in `row`
    place[row] = np.arange(len(row))

    n = len(row)
    inside = np.empty(((BRICK + 1,) * 3 + (n,)), dtype=bool)
    own = np.ascontiguousarray(own.T).reshape(BRICK, BRICK, BRICK, -1)
    for k, corner in enumerate(CORNERS):
        to = tuple(slice(BRICK, None) if c else slice(0, BRICK) for c in corner)
        of = tuple(slice(0, 1) if c else slice(None) for c in corner)
        inside[to] = own[of].take(beside[k], axis=-1)
    crossed = np.empty((*(BRICK,) * 3, 3, n), dtype=bool)
    here = inside[:BRICK, :BRICK, :BRICK]
    case = np.zeros(here.shape, dtype=np.uint8)
    for k, (x, y, z) in enumerate(CORNERS):
        there = inside[x : x + BRICK, y : y + BRICK, z : z + BRICK]
        case |= there.view(np.uint8) << k
        if k in STRIDES:
            np.not_equal(here, there, out=crossed[..., STRIDES.index(k), :])
    at = np.flatnonzero(crossed)
    edge, brick = np.divmod(at.astype(np.int32), n)
    number = np.zeros(crossed.size, dtype=np.int32)
    number[at] = np.arange(len(at))

    start, whose, slot = case_table()
    at = np.flatnonzero((case > 0) & (case < 255))
    case = case.ravel()[at]
    first_face = np.concatenate([[0], np.cumsum(start[1:][case] - start[case])])
    triangle = start[case] - first_face[:-1]  # plus the number of a face: its row in the table
    owner = place[beside].ravel()
    faces = np.empty((first_face[-1], 3), dtype=np.int64)
    ends = np.empty((len(edge), 2), dtype=np.int32)

    def find_faces(first: int, last: int) -> None:
        count = np.diff(first_face[first : last + 1])
        these = np.arange(first_face[first], first_face[last])
        node, home = np.divmod(at[first:last], n)
        row_of = np.repeat(node * len(whose[0]) + triangle[first:last], count) + these
        brick_of = owner.take(np.repeat(home, count)[:, None] + n * whose.reshape(-1, 3).take(row_of, axis=0))
        faces[these[0] : these[-1] + 1] = number.take(slot.reshape(-1, 3).take(row_of, axis=0) * n + brick_of)

    def find_ends(first: int, last: int) -> None:
        far = FAR_END[edge[first:last]]
        ends[first:last, 0] = row[brick[first:last]] * len(LOCAL) + edge[first:last] // 3
        ends[first:last, 1] = beside[WHOSE[far], brick[first:last]] * len(LOCAL) + NUMBER[far]

    over_rows(find_faces, len(at), CELLS_AT_ONCE)
    over_rows(find_ends, len(edge), CELLS_AT_ONCE)
    return ends, edge % 3, faces


@lru_cache(maxsize=1)
def case_table() -> tuple[I64, I64, I64]:
    """The triangles of each case, for a cell at each of a brick's nodes.

    Those of case c, the sum of 2^corner over the inside corners, are rows start[c] to start[c + 1] of (64, rows, 3)
    whose and slot: by corner, whose brick the edge with that corner belongs to, and its number there, 3 * node + axis.
    """
    cases = [_triangles(case) for case in range(256)]
    edges = np.array([t for case in cases for t in case])
    start = np.concatenate([[0], np.cumsum([len(case) for case in cases])])
    lower, axis = np.array(EDGES).T
    padded = OWN[:, None, None] + (np.array(CORNERS) @ PADDED_STRIDES)[lower[edges]]
    return start, WHOSE[padded], 3 * NUMBER[padded] + axis[edges]


def _triangles(case: int) -> list[Triangle]:
    """The surface in a cell as triangles of edge numbers."""
    inside = [bool(case >> c & 1) for c in range(8)]
    follows: dict[int, int] = {}
    for face in _faces():
        for i in range(4):
            if not inside[face[i]] and inside[face[i - 1]]:  # a run of outside corners starts here
                j = i
                while not inside[face[(j + 1) % 4]]:
                    j += 1
                follows[_edge(face[j % 4], face[(j + 1) % 4])] = _edge(face[i - 1], face[i])
    out: list[Triangle] = []
    while follows:
        loop = [next(iter(follows))]
        while (edge := follows.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        triangles = _triangulated(loop)
        assert triangles is not None  # of 256 cases there is none without
        out += triangles
    return out


def _triangulated(loop: list[int]) -> list[Triangle] | None:
    """A polygon of edge numbers as triangles none of whose diagonals lies in a face of the cell."""
    last = len(loop) - 1
    if last < 2:
        return []
    for k in range(1, last):
        if all(j - i == 1 or not _share_face(loop[i], loop[j]) for i, j in ((0, k), (k, last))):
            parts = _triangulated(loop[: k + 1]), _triangulated(loop[k:])
            if parts[0] is not None and parts[1] is not None:
                return [(loop[0], loop[k], loop[last]), *parts[0], *parts[1]]
    return None


@lru_cache(maxsize=1)
def _faces() -> list[tuple[int, int, int, int]]:
    """The corners of each face, anticlockwise from outside."""
    out = []
    for axis, side in product(range(3), (0, 1)):
        u, v = STRIDES[(axis + 1) % 3], STRIDES[(axis + 2) % 3]
        base = side * STRIDES[axis]
        ring = (base, base + u, base + u + v, base + v)
        out.append(ring if side else ring[::-1])
    return out


def _edge(a: int, b: int) -> int:
    return EDGES.index((min(a, b), STRIDES.index(abs(a - b))))


def _share_face(a: int, b: int) -> bool:
    ends = [{lower, lower + STRIDES[axis]} for lower, axis in (EDGES[a], EDGES[b])]
    return any(ends[0] | ends[1] <= set(face) for face in _faces())
