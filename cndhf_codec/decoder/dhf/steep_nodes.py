"""Evaluate the networks at grid nodes next to steep walls.

Where heights rise by many spacings within one cell of a height table, the wall may stand anywhere in that cell, and the
table does not say on which side of it a node lies. The isosurface of the tables alone would be ragged there, and up to
a spacing off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...arrays import I32, I64, Mask
from .band import BRICK_SIDE, FIRST_BRICK_ROW, NO_DHF, NODE_OFFSETS, NODES_PER_BRICK, Band, clip_magnitude
from .field import Dhf
from .marching_cubes import NODE_STRIDES

# Evidence for these constants: ADR 029.
#
# An edge of the grid is steep where f differs by more than this between its ends, in spacings. In space f can change by
# one spacing per spacing only: heights rise there by more than 70 degrees.
STEEP_DIFFERENCE = 3.0
NEIGHBOUR_OFFSETS = np.indices((3, 3, 3)).reshape(3, 27) - 1
FIRST_BRICK_NODE = NODES_PER_BRICK * FIRST_BRICK_ROW  # nodes below this stand for the bricks without surface
PAIR_STRIDE = NO_DHF + 1  # a node and a DHF to evaluate there are one number, PAIR_STRIDE * node + DHF
PAIRS_AT_ONCE = 2**15  # bounds the memory


def refine_steep_nodes(band: Band, dhfs: Sequence[Dhf], ends: I32) -> bool:
    """Replace f, in the band, by its exact value at the ends of steep edges.

    ends: (N, 2) as in `marching_cubes.Edges`. Returns whether any node has changed sides.
    """
    values = band.values.reshape(-1).take(ends.T)
    steep = ends[np.abs(values[0] - values[1]) > STEEP_DIFFERENCE].astype(np.int64)
    # The DHF that owns one end may own the other, too.
    owners = band.owners.reshape(-1).take(steep)
    pairs = np.unique(PAIR_STRIDE * steep[:, :, None] + owners[:, None, :])
    node, number = np.divmod(pairs, PAIR_STRIDE)
    keep = (node >= FIRST_BRICK_NODE) & (number != NO_DHF)
    node, number = node[keep], number[keep]
    first, changed = 0, False
    while first < len(node):
        # All pairs of a node belong to one part.
        last = int(np.searchsorted(node, node[min(first + PAIRS_AT_ONCE, len(node)) - 1], side="right"))
        changed |= _refine(band, dhfs, node[first:last], number[first:last])
        first = last
    return changed


def _refine(band: Band, dhfs: Sequence[Dhf], node: I64, number: I64) -> bool:
    """Set nodes to the least f of their DHFs, for pairs (N,) sorted by node; whether any node changes sides."""
    values, owners = band.values.reshape(-1), band.owners.reshape(-1)
    nodes, which = np.unique(node, return_inverse=True)
    wanted = np.zeros((len(nodes), len(dhfs)), dtype=bool)
    wanted[which, number] = True
    at = _grid_indices(band, nodes)
    points = (band.grid.origin + band.grid.spacing * at.T).astype(np.float32)
    f = np.full(wanted.shape, np.inf, dtype=np.float32)
    was = values[nodes]
    # Second round: a node that the tables have outside and these DHFs inside may be outside of another DHF.
    for _ in range(2):
        for k, dhf in enumerate(dhfs):
            rows = np.flatnonzero(wanted[:, k])
            f[rows, k] = dhf.implicit(points[rows]) / np.float32(band.grid.spacing)
        wanted = ~wanted & ((was < 0) & (f.min(axis=1) >= 0))[:, None]
    now = f.min(axis=1)
    clip_magnitude(now)

    # Nodes at the grid's border keep their value, and so do those that would differ from a brick without surface next
    # to them: the surface could not continue there.
    inner = (at > 0) & (at < np.array(band.grid.shape)[:, None] - 1)
    allowed: Mask = np.all(inner, axis=0)
    changed = np.flatnonzero(allowed & ((now >= 0) != (was >= 0)))
    around = _node_numbers(band, at[:, changed, None] + NEIGHBOUR_OFFSETS[:, None])
    no_surface = around < FIRST_BRICK_NODE
    stopped = (no_surface & ((values[around] >= 0) != (now[changed] >= 0)[:, None])).any(axis=1)
    allowed[changed[stopped]] = False
    values[nodes[allowed]] = now[allowed]
    owners[nodes[allowed]] = f.argmin(axis=1)[allowed]
    return not stopped.all()


def _grid_indices(band: Band, nodes: npt.NDArray[np.integer]) -> I32:
    """Indices (3, N) in the grid of nodes (N,) of the band."""
    row, node = np.divmod(nodes, NODES_PER_BRICK)
    return band.corners.T.take(row, axis=1) + NODE_OFFSETS.T.take(node, axis=1)


def _node_numbers(band: Band, at: npt.NDArray[np.integer]) -> I64:
    """The band's nodes (...) at indices (3, ...) in the grid."""
    corners = (at - at % BRICK_SIDE).astype(np.int32)
    node = np.tensordot(NODE_STRIDES, at % BRICK_SIDE, 1)
    return band.rows(corners).astype(np.int64) * NODES_PER_BRICK + node
