"""Marching cubes (Lorensen and Cline, 1987) on the bricks of a narrow band.

scikit-image's works on dense grids: looking at each of their cells takes longer than all that is done here.

The table of cases is made by rule. On each face of a cell, outside corners that lie next to one another are cut off
together from the rest: so inside corners across a face's diagonal are joined, and thin walls hold together. Both cells
of a face do the same, so the surface is closed. No triangle has an edge within a face that the rule did not put
there, so no edge of the surface has more than two triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt

from ...arrays import I32, I64, Mask
from ..parallel import over_rows
from .band import BRICK, INSIDE, LOCAL, Band

# Corner c of a cell is at (c >> 2 & 1, c >> 1 & 1, c & 1). An edge is its lower corner and its axis.
CORNERS = tuple(product((0, 1), repeat=3))
STRIDES = (4, 2, 1)
EDGES = tuple((c, axis) for c in range(8) for axis in range(3) if not CORNERS[c][axis])
Triangle = tuple[int, int, int]
CELLS_AT_ONCE = 2**14

# A brick's nodes and those just above it, (125, 3): whose brick each is (by corner), and its number in it.
PADDED = np.indices((BRICK + 1,) * 3).reshape(3, -1).T
WHOSE = (PADDED // BRICK) @ STRIDES
NUMBER = (PADDED % BRICK) @ (BRICK * BRICK, BRICK, 1)
PADDED_STRIDES = np.array([(BRICK + 1) ** 2, BRICK + 1, 1])
OWN = LOCAL @ PADDED_STRIDES  # (64,) the brick's own nodes in that order
FAR_END = (OWN + PADDED_STRIDES[:, None]).ravel()  # (192,) of the edge 64 * axis + node

# A brick's nodes are the bits of a word. By axis: how many bits a step along it is, and the nodes farthest along it.
SHIFTS = (BRICK * BRICK, BRICK, 1)
LAST = [sum(1 << i for i, node in enumerate(LOCAL) if node[axis] == BRICK - 1) for axis in range(3)]


@dataclass(frozen=True)
class Edges:
    """The edges of the grid that the surface crosses.

    ends: (N, 2) nodes at both ends, as 64 * row + node with node 0 to 63 of the band's brick in that row. axis: (N,)
    """

    ends: I32
    axis: I32
    _row: I32  # (n,) bricks with an edge or a corner of a cell that is crossed
    _beside: I32  # (n, 8) the bricks at their corners
    _corner: npt.NDArray[np.uint64]  # (8, n) whether each corner of the cells at their nodes is inside
    _mixed: npt.NDArray[np.uint64]  # (n,) whether those cells have corners of both kinds
    _at: I64  # (N,) 192 * number in _row + 64 * axis + node of the edge's lower end


def bricks_beside(band: Band) -> I32:
    """(8, n) rows of the bricks at the corners (0, 0, 0), (0, 0, 1), ... of all with values of their own: those that
    hold the nodes just above them."""
    # Bricks last: numpy is fast along long last dimensions.
    steps = np.array(CORNERS, dtype=np.int32).T * BRICK
    return band.rows(np.ascontiguousarray(band.corners[INSIDE + 1 :].T)[:, None] + steps[..., None])


def crossed_edges(band: Band, beside: I32) -> Edges:
    """Where the surface crosses the grid. beside: what `bricks_beside` gives."""
    inside = np.packbits(band.values >= 0, axis=1, bitorder="little").view("<u8")[:, 0].astype(np.uint64)
    corner = inside[beside]
    for shift, last, stride in zip(SHIFTS, LAST, STRIDES, strict=True):
        for c in (c for c in range(8) if not c & stride):
            here, ahead = corner[c] >> np.uint64(shift), corner[c + stride] << np.uint64((BRICK - 1) * shift)
            corner[c + stride] = (here & ~np.uint64(last)) | (ahead & np.uint64(last))
    # Now a node's bit in corner[c] says whether corner c of the cell at that node is inside.
    mixed = np.bitwise_or.reduce(corner) & ~np.bitwise_and.reduce(corner)
    some = np.flatnonzero(mixed)
    row, beside, corner = (some + INSIDE + 1).astype(np.int32), np.ascontiguousarray(beside.T[some]), corner[:, some]

    at = np.flatnonzero(_bits(np.stack([corner[0] ^ corner[stride] for stride in STRIDES], axis=1)))
    brick, edge = np.divmod(at.astype(np.int32), len(FAR_END))
    ends = np.empty((len(edge), 2), dtype=np.int32)

    def find_ends(first: int, last: int) -> None:
        far, home = FAR_END[edge[first:last]], brick[first:last]
        ends[first:last, 0] = row[home] * len(LOCAL) + edge[first:last] % len(LOCAL)
        ends[first:last, 1] = beside[home, WHOSE[far]] * len(LOCAL) + NUMBER[far]

    over_rows(find_ends, len(edge), CELLS_AT_ONCE)
    return Edges(ends, edge // len(LOCAL), row, beside, corner, mixed[some], at)


def faces_between(band: Band, edges: Edges) -> I64:
    """How the crossings join: triangles (M, 3) of numbers of edges, seen anticlockwise from outside."""
    row, corner = edges._row, edges._corner
    number = np.empty(len(row) * len(FAR_END), dtype=np.int32)
    number[edges._at] = np.arange(len(edges._at))
    place = np.zeros(len(band.values), dtype=np.int32)  # of a brick's first number
    place[row] = np.arange(0, len(number), len(FAR_END))
    place = place[edges._beside].ravel()

    at = np.flatnonzero(_bits(edges._mixed))
    case = np.zeros(len(row) * len(LOCAL), dtype=np.uint8)
    for k in range(8):
        case |= _bits(corner[k]).view(np.uint8) << k
    case = case[at]
    count, start, whose, slot = case_table()
    count, start = count[case], start[case]
    first_face = np.zeros(len(at) + 1, dtype=np.int64)
    np.cumsum(count, out=first_face[1:])
    start -= first_face[:-1]  # plus the number of a face: its row in the table
    faces = np.empty((first_face[-1], 3), dtype=np.int64)

    def find_faces(first: int, last: int) -> None:
        these = slice(first_face[first], first_face[last])
        cell = np.zeros(
            these.stop - these.start, dtype=np.int64
        )  # of each face; numpy.repeat lets no thread run beside
        cell[first_face[first + 1 : last] - these.start] = 1
        np.cumsum(cell, out=cell)
        home, node = at[first:last] // len(LOCAL), at[first:last] % len(LOCAL)
        row_of = (node * len(whose[0]) // len(LOCAL) + start[first:last]).take(cell)
        row_of += np.arange(these.start, these.stop)
        home = (home * len(CORNERS)).take(cell)
        at_edge = whose.take(row_of, axis=1) + home
        at_edge = place.take(at_edge)
        at_edge += slot.take(row_of, axis=1)
        for k, numbers in enumerate(at_edge):  # numpy is slow along rows of three
            faces[these, k] = number.take(numbers)

    over_rows(find_faces, len(at), CELLS_AT_ONCE)
    return faces


def _bits(words: npt.NDArray[np.uint64]) -> Mask:
    """The bits of words, lowest first, one after the other."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), bitorder="little").view(bool)


@lru_cache(maxsize=1)
def case_table() -> tuple[I64, I64, npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """The triangles of each case, for a cell at each of a brick's nodes.

    Those of case c, the sum of 2^corner over the inside corners, are count[c] rows from start[c] on of (3, 64, rows)
    whose and slot: by corner, whose brick the edge with that corner belongs to, and its number there, 64 * axis + node.
    """
    cases = [_triangles(case) for case in range(256)]
    edges = np.array([t for case in cases for t in case])
    count = np.array([len(case) for case in cases])
    lower, axis = np.array(EDGES)[edges.T].transpose(2, 0, 1)[:, :, None]
    padded = OWN[:, None] + (np.array(CORNERS) @ PADDED_STRIDES)[lower]
    slot = NUMBER[padded] + len(LOCAL) * axis
    return count, np.cumsum(count) - count, *(x.astype(np.uint8).reshape(3, -1) for x in (WHOSE[padded], slot))


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
