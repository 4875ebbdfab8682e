"""Steep walls, beside which a height table does not tell which nodes are inside.

Where heights rise by many spacings within a cell of the table, the wall may stand anywhere in that cell: a surface
from the table alone is up to a spacing off there, and ragged. The nodes beside such walls are asked of the networks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...arrays import I32, I64, Mask
from .band import BRICK, INSIDE, LOCAL, NOBODY, Band, keep_between
from .field import Dhf
from .marching_cubes import SHIFTS

STEEP = 3.0  # f differs by more between neighbouring nodes, in spacings: heights rise by more than 70 degrees
AROUND = np.indices((3, 3, 3)).reshape(3, 27) - 1
SURE = len(LOCAL) * (INSIDE + 1)  # nodes below this are of bricks without surface
FIELDS = NOBODY + 1  # a question is FIELDS * node + DHF
AT_ONCE = 2**15  # questions; memory


def set_walls_right(band: Band, dhfs: Sequence[Dhf], ends: I32) -> bool:
    """Give the nodes beside steep walls their exact f, in the band. ends: (N, 2), see `cubes.Edges`.

    Returns whether any node has changed sides.
    """
    values = band.values.reshape(-1).take(ends.T)
    steep = ends[np.abs(values[0] - values[1]) > STEEP].astype(np.int64)
    # What holds one end may hold the other, too.
    holders = band.holders.reshape(-1).take(steep)
    questions = np.unique(FIELDS * steep[:, :, None] + holders[:, None, :])
    node, field = np.divmod(questions, FIELDS)
    keep = (node >= SURE) & (field != NOBODY)
    node, field = node[keep], field[keep]
    first, turned = 0, False
    while first < len(node):
        # All that is asked about a node is asked at once.
        last = int(np.searchsorted(node, node[min(first + AT_ONCE, len(node)) - 1], side="right"))
        turned |= _ask(band, dhfs, node[first:last], field[first:last])
        first = last
    return turned


def _ask(band: Band, dhfs: Sequence[Dhf], node: I64, field: I64) -> bool:
    """Set nodes, sorted, to the least f of the DHFs that their rows name; whether any of them changes sides."""
    values, holders = band.values.reshape(-1), band.holders.reshape(-1)
    nodes, which = np.unique(node, return_inverse=True)
    ask = np.zeros((len(nodes), len(dhfs)), dtype=bool)
    ask[which, field] = True
    places = _places(band, nodes)
    points = (band.grid.origin + band.grid.spacing * places.T).astype(np.float32)
    f = np.full(ask.shape, np.inf, dtype=np.float32)
    was = values[nodes]
    # By the table others do not matter; but they may hold what turns out not to be held by these.
    for _ in range(2):
        for k, dhf in enumerate(dhfs):
            rows = np.flatnonzero(ask[:, k])
            f[rows, k] = dhf.implicit(points[rows]) / np.float32(band.grid.spacing)
        ask = ~ask & ((was < 0) & (f.min(axis=1) >= 0))[:, None]
    now = f.min(axis=1)
    keep_between(now)

    # At the grid's border, and beside a brick without surface, nodes stay: the surface could not go on there.
    inner = (places > 0) & (places < np.array(band.grid.shape)[:, None] - 1)
    right: Mask = np.all(inner, axis=0)
    turned = np.flatnonzero(right & ((now >= 0) != (was >= 0)))
    around = _nodes_at(band, places[:, turned, None] + AROUND[:, None])
    stopped = ((around < SURE) & ((values[around] >= 0) != (now[turned] >= 0)[:, None])).any(axis=1)
    right[turned[stopped]] = False
    values[nodes[right]] = now[right]
    holders[nodes[right]] = f.argmin(axis=1)[right]
    return not stopped.all()


def _places(band: Band, nodes: npt.NDArray[np.integer]) -> I32:
    """(3, N) of nodes in the grid."""
    row, node = np.divmod(nodes, len(LOCAL))
    return band.corners.T.take(row, axis=1) + LOCAL.T.take(node, axis=1)


def _nodes_at(band: Band, places: npt.NDArray[np.integer]) -> I64:
    """The nodes at places (3, ...) in the grid."""
    corners = (places - places % BRICK).astype(np.int32)
    local = np.tensordot(SHIFTS, places % BRICK, 1)
    return band.rows(corners).astype(np.int64) * len(LOCAL) + local
