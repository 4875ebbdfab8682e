"""Marching cubes (Lorensen and Cline, 1987) on the bricks of a narrow band.

scikit-image's works on dense grids: to look at each of their cells takes longer than all the steps here together.

The table of the 256 cases is made by a rule. On each face of a cell, every run of outside corners is cut off from the
rest. So inside corners across a face's diagonal are joined, and thin walls hold together. The two cells of a face cut
it in the same way, so the surface is closed. Triangles have no other edges within a face, so no edge of the surface has
more than two triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import I32, I64, Mask
from ..parallel import over_rows
from .band import BRICK_SIDE, FIRST_BRICK_ROW, NODE_OFFSETS, NODES_PER_BRICK, Band

# Corner c of a cell is at (c >> 2 & 1, c >> 1 & 1, c & 1). An edge is its lower corner and its axis.
CORNERS = tuple(product((0, 1), repeat=3))
CORNER_STRIDES = (4, 2, 1)
EDGES = tuple((c, axis) for c in range(8) for axis in range(3) if not CORNERS[c][axis])
Triangle = tuple[int, int, int]
ITEMS_AT_ONCE = 2**14  # edges or cells, per thread

# Node i of a brick is at NODE_OFFSETS[i]; NODE_STRIDES @ NODE_OFFSETS[i] = i.
NODE_STRIDES = (BRICK_SIDE * BRICK_SIDE, BRICK_SIDE, 1)
EDGES_PER_BRICK = 3 * NODES_PER_BRICK  # edge 64 * axis + node goes from that node along that axis

# A padded brick: its nodes and those just above them, 125. For each, the brick that it belongs to (this one is 0, those
# above are the bits of CORNER_STRIDES) and its number in that brick.
PADDED_OFFSETS = np.indices((BRICK_SIDE + 1,) * 3).reshape(3, -1).T
PADDED_BRICK = (PADDED_OFFSETS // BRICK_SIDE) @ CORNER_STRIDES
PADDED_NODE = (PADDED_OFFSETS % BRICK_SIDE) @ NODE_STRIDES
PADDED_STRIDES = np.array([(BRICK_SIDE + 1) ** 2, BRICK_SIDE + 1, 1])
NODE_IN_PADDED = NODE_OFFSETS @ PADDED_STRIDES  # (64,) numbers of a brick's nodes in its padded brick
UPPER_END = (NODE_IN_PADDED + PADDED_STRIDES[:, None]).ravel()  # (192,) of each edge, in the padded brick

# A brick's nodes as the bits of a word. For each axis, the bits of the nodes that are last along it.
LAST_NODES = [sum(1 << i for i, at in enumerate(NODE_OFFSETS) if at[axis] == BRICK_SIDE - 1) for axis in range(3)]


@dataclass(frozen=True)
class Edges:
    """The N edges of the grid that the surface crosses, and the n bricks in whose cells it lies.

    ends: (N, 2) nodes at both ends, lower first, as 64 * row + node, for node 0 to 63 of the band's brick in that row.
    axis: (N,) direction.
    """

    ends: I32
    axis: I32
    _row: I32  # (n,) rows of the bricks
    _neighbours: I32  # (n, 8) rows of the bricks around their upper corners, as in `neighbour_bricks`
    _corner_inside: npt.NDArray[np.uint64]  # (8, n) a bit per node: whether corner c of its cell is inside
    _crossed: npt.NDArray[np.uint64]  # (n,) a bit per node: whether its cell has corners inside and outside
    _number: I64  # (N,) 192 * place in _row + edge of the brick


def neighbour_bricks(band: Band) -> I32:
    """Rows (8, n) of the n bricks themselves and of those that hold the nodes just above them.

    By corner of a cell: (0, 0, 0) is the brick itself, (0, 0, 1) the next one along the last axis, and so on.
    """
    # Bricks last: numpy is fast along long last dimensions.
    steps = np.array(CORNERS, dtype=np.int32).T * BRICK_SIDE
    return band.rows(np.ascontiguousarray(band.corners[FIRST_BRICK_ROW:].T)[:, None] + steps[..., None])


def crossed_edges(band: Band, neighbours: I32) -> Edges:
    """Find where the surface crosses the grid. neighbours: from `neighbour_bricks`."""
    inside = np.packbits(band.values >= 0, axis=1, bitorder="little").view("<u8")[:, 0].astype(np.uint64)
    corner = inside[neighbours]
    # Shifted along each axis in turn, until a node's bit in corner[c] tells whether corner c of its cell is inside.
    for shift, last, stride in zip(NODE_STRIDES, LAST_NODES, CORNER_STRIDES, strict=True):
        for c in (c for c in range(8) if not c & stride):
            here, ahead = corner[c] >> np.uint64(shift), corner[c + stride] << np.uint64((BRICK_SIDE - 1) * shift)
            corner[c + stride] = (here & ~np.uint64(last)) | (ahead & np.uint64(last))
    crossed = np.bitwise_or.reduce(corner) & ~np.bitwise_and.reduce(corner)
    some = np.flatnonzero(crossed)
    row = (some + FIRST_BRICK_ROW).astype(np.int32)
    neighbours, corner = np.ascontiguousarray(neighbours.T[some]), corner[:, some]

    number = np.flatnonzero(_bits(np.stack([corner[0] ^ corner[stride] for stride in CORNER_STRIDES], axis=1)))
    brick, edge = np.divmod(number.astype(np.int32), EDGES_PER_BRICK)
    ends = np.empty((len(edge), 2), dtype=np.int32)

    def find_ends(first: int, last: int) -> None:
        upper, home = UPPER_END[edge[first:last]], brick[first:last]
        ends[first:last, 0] = row[home] * NODES_PER_BRICK + edge[first:last] % NODES_PER_BRICK
        ends[first:last, 1] = neighbours[home, PADDED_BRICK[upper]] * NODES_PER_BRICK + PADDED_NODE[upper]

    over_rows(find_ends, len(edge), ITEMS_AT_ONCE)
    return Edges(ends, edge // NODES_PER_BRICK, row, neighbours, corner, crossed[some], number)


def faces_between(band: Band, edges: Edges) -> I64:
    """Triangles (M, 3) between the crossings: numbers of edges in `edges`, anticlockwise seen from outside."""
    row = edges._row
    vertex = np.empty(len(row) * EDGES_PER_BRICK, dtype=np.int32)  # of each edge that is crossed
    vertex[edges._number] = np.arange(len(edges._number))
    place = np.zeros(len(band.values), dtype=np.int32)  # of a brick's first edge in `vertex`
    place[row] = np.arange(0, len(vertex), EDGES_PER_BRICK)
    place = place[edges._neighbours].ravel()

    at = np.flatnonzero(_bits(edges._crossed))  # cells: 64 * place of the brick + node
    case = np.zeros(len(row) * NODES_PER_BRICK, dtype=np.uint8)
    for k in range(8):
        case |= _bits(edges._corner_inside[k]).view(np.uint8) << k
    case = case[at]
    table = case_table()
    start = table.start[case]
    first_face = np.zeros(len(at) + 1, dtype=np.int64)
    np.cumsum(table.n_faces[case], out=first_face[1:])
    start -= first_face[:-1]  # so that start plus the number of a face is its column in the table
    faces = np.empty((first_face[-1], 3), dtype=np.int64)

    def find_faces(first: int, last: int) -> None:
        these = slice(first_face[first], first_face[last])
        # The cell of each face. A sum of ones where cells start: numpy.repeat would hold the interpreter's lock.
        cell = np.zeros(these.stop - these.start, dtype=np.int64)
        cell[first_face[first + 1 : last] - these.start] = 1
        np.cumsum(cell, out=cell)
        home, node = at[first:last] // NODES_PER_BRICK, at[first:last] % NODES_PER_BRICK
        column = (node * len(table.brick[0]) // NODES_PER_BRICK + start[first:last]).take(cell)
        column += np.arange(these.start, these.stop)
        home = (home * len(CORNERS)).take(cell)
        edge = table.brick.take(column, axis=1) + home
        edge = place.take(edge)
        edge += table.edge.take(column, axis=1)
        for k, numbers in enumerate(edge):  # numpy is slow along rows of three
            faces[these, k] = vertex.take(numbers)

    over_rows(find_faces, len(at), ITEMS_AT_ONCE)
    return faces


def _bits(words: npt.NDArray[np.uint64]) -> Mask:
    """The bits of all words in turn, lowest first."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), bitorder="little").view(bool)


class CaseTable(NamedTuple):
    """The triangles of each case, for a cell at each of a brick's nodes.

    A case is the sum of 2^corner over a cell's inside corners. Case c at node n has the triangles in columns
    start[c] to start[c] + n_faces[c] of brick and edge, read as (3, 64, columns) at [:, n]. For each of the three
    corners of a triangle they tell which grid edge it lies on: `brick` is the edge's brick (0 to 7, as in
    `neighbour_bricks`) and `edge` its number there, 64 * axis + node.

    n_faces, start: (256,). brick, edge: (3, 64 * columns).
    """

    n_faces: I64
    start: I64
    brick: npt.NDArray[np.uint8]
    edge: npt.NDArray[np.uint8]


@lru_cache(maxsize=1)
def case_table() -> CaseTable:
    """Make the table of cases, once."""
    cases = [_triangles(case) for case in range(256)]
    edges = np.array([t for case in cases for t in case])
    n_faces = np.array([len(case) for case in cases])
    lower, axis = np.array(EDGES)[edges.T].transpose(2, 0, 1)[:, :, None]
    padded = NODE_IN_PADDED[:, None] + (np.array(CORNERS) @ PADDED_STRIDES)[lower]
    number = PADDED_NODE[padded] + NODES_PER_BRICK * axis
    brick, edge = (x.astype(np.uint8).reshape(3, -1) for x in (PADDED_BRICK[padded], number))
    return CaseTable(n_faces, np.cumsum(n_faces) - n_faces, brick, edge)


def _triangles(case: int) -> list[Triangle]:
    """The surface within a cell: triangles of numbers in EDGES."""
    inside = [bool(case >> c & 1) for c in range(8)]
    follows: dict[int, int] = {}
    for face in _faces():
        for i in range(4):
            if not inside[face[i]] and inside[face[i - 1]]:  # the first of a run of outside corners
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
        assert triangles is not None  # true for all 256 cases
        out += triangles
    return out


def _triangulated(loop: list[int]) -> list[Triangle] | None:
    """A polygon of edge numbers as triangles, without diagonals within a face of the cell; None if impossible."""
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
    """The corners of each face of a cell, anticlockwise seen from outside."""
    out = []
    for axis, side in product(range(3), (0, 1)):
        u, v = CORNER_STRIDES[(axis + 1) % 3], CORNER_STRIDES[(axis + 2) % 3]
        base = side * CORNER_STRIDES[axis]
        ring = (base, base + u, base + u + v, base + v)
        out.append(ring if side else ring[::-1])
    return out


def _edge(a: int, b: int) -> int:
    """The number in EDGES of the edge between two corners."""
    return EDGES.index((min(a, b), CORNER_STRIDES.index(abs(a - b))))


def _share_face(a: int, b: int) -> bool:
    """Whether two edges lie in one face of the cell."""
    ends = [{lower, lower + CORNER_STRIDES[axis]} for lower, axis in (EDGES[a], EDGES[b])]
    return any(ends[0] | ends[1] <= set(face) for face in _faces())
