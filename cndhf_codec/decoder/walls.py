"""Steep walls, beside which a height table does not tell which nodes are inside.

Where heights rise by many spacings within a cell of the table, the wall may stand anywhere in that cell: a surface
from the table alone is up to a spacing off there, and ragged. The nodes beside such walls are asked of the networks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .band import BRICK, I32, INSIDE, LEAST, LOCAL, MOST, NOBODY, Band
from .dhf import Dhf

STEEP = 3.0  # f differs by more between neighbouring nodes, in spacings: heights rise by more than 70 degrees
AROUND = np.indices((3, 3, 3)).reshape(3, 27) - 1
SURE = len(LOCAL) * (INSIDE + 1)  # nodes below this are of bricks without surface

I64 = npt.NDArray[np.int64]


def set_walls_right(band: Band, dhfs: Sequence[Dhf], ends: I32) -> bool:
    """Give the nodes beside steep walls their exact f, in the band. ends: (N, 2), see `cubes.Edges`.

    Returns whether any node has changed sides.
    """
    values, holders = band.values.reshape(-1), band.holders.reshape(-1)
    of_ends = values.take(ends.T)
    steep = ends[np.abs(of_ends[0] - of_ends[1]) > STEEP]
    nodes, which = np.unique(steep, return_inverse=True)
    # What holds one end may hold the other, too.
    ask = np.zeros((len(nodes), len(dhfs)), dtype=bool)
    held = holders.take(steep)
    for end, holder in ((0, 0), (0, 1), (1, 0), (1, 1)):
        some = held[:, holder] != NOBODY
        ask[which.reshape(-1, 2)[some, end], held[some, holder]] = True
    places = _places(band, nodes)
    free = (nodes >= SURE) & ((places > 0) & (places < np.array(band.grid.shape)[:, None] - 1)).all(axis=0)
    nodes, ask, places = nodes[free], ask[free], places[:, free]
    if not len(nodes):
        return False

    points = (band.grid.origin + band.grid.spacing * places.T).astype(np.float32)
    f = np.full(ask.shape, np.inf, dtype=np.float32)
    was = values[nodes]
    # By the table others do not matter; but they may hold what turns out not to be held by these.
    for _ in range(2):
        for k, dhf in enumerate(dhfs):
            rows = np.flatnonzero(ask[:, k])
            f[rows, k] = dhf.implicit(points[rows]) / np.float32(band.grid.spacing)
        ask = ~ask & ((was < 0) & (f.min(axis=1) >= 0))[:, None]
    now = np.clip(f.min(axis=1), -MOST, MOST)
    now = np.where(now >= 0, np.maximum(now, LEAST), np.minimum(now, -LEAST))

    # Beside a brick without surface nodes stay as they are: the surface could not go on there.
    turned = np.flatnonzero((now >= 0) != (was >= 0))
    around = _nodes_at(band, places[:, turned, None] + AROUND[:, None])
    stopped = ((around < SURE) & ((values[around] >= 0) != (now[turned] >= 0)[:, None])).any(axis=1)
    right = np.ones(len(nodes), dtype=bool)
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
    local = np.tensordot(np.array([BRICK * BRICK, BRICK, 1]), places % BRICK, 1)
    return band.rows(corners).astype(np.int64) * len(LOCAL) + local
