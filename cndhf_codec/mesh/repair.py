"""Make faces ready to bound a solid, by their connections alone: each once, and neighbours looking the same way.

Rays decide later which way a whole patch looks (`solid.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import F64, I64, Mask
from .connectivity import Edges, connected, edges_of
from .read import distinct_rows

# Evidence for these constants: ADR 002.
MOST_FLAP = 0.01  # share of the whole area up to which a flap of doubled faces is dropped; a larger one is a sheet


@dataclass(frozen=True, eq=False)
class Repaired:
    """Faces made ready to bound a solid, in patches: faces connected across edges of two faces.

    faces: (M', 3). turned: (M',) whether the face was reversed. patch: (M',) number of its patch. open_patch: (P,)
    whether the patch has an edge that is not of two faces. repeated: number of faces left out as copies. doubled: (M',)
    whether the face was given in both orientations. dropped_pairs: number of pairs of opposite faces left out.
    """

    faces: I64
    turned: Mask
    patch: I64
    open_patch: Mask
    repeated: int
    doubled: Mask
    dropped_pairs: int


def repair(faces: I64, areas: F64, vertices: int) -> Repaired:
    """Leave out copies, resolve opposite pairs, and turn neighbours to look the same way.

    faces: (M, 3), none with a vertex twice. areas: (M,). vertices: how many there are.
    """
    source, doubled, repeated, pairs = _each_once(faces, areas, vertices)
    kept = faces[source]
    edges = edges_of(kept, vertices)
    patch, turned = _patches(edges, areas[source])
    kept[turned] = kept[turned][:, ::-1]
    open_patch = np.zeros(patch.max() + 1, dtype=bool)
    open_patch[patch[~edges.paired[edges.of].all(axis=0)]] = True
    return Repaired(kept, turned, patch, open_patch, repeated, doubled, pairs)


def _each_once(faces: I64, areas: F64, vertices: int) -> tuple[I64, Mask, int, int]:
    """Choose the faces to keep (ascending). Returns also which of them were given in both orientations, and how many
    copies and pairs are left out."""
    distinct, group = distinct_rows(np.sort(faces, axis=1))
    if len(distinct) == len(faces):
        return np.arange(len(faces)), np.zeros(len(faces), dtype=bool), 0, 0
    ranks = np.argsort(faces, axis=1)
    sign = np.where((ranks[:, 1] - ranks[:, 0]) % 3 == 1, 1, -1)
    net = np.bincount(group, weights=sign).astype(np.int64)
    # Keep of every group the first face that looks the way most of them do; of a pair, the first.
    fitting = np.flatnonzero(sign * np.sign(net)[group] >= 0)
    source = np.sort(fitting[np.unique(group[fitting], return_index=True)[1]])
    doubled = net[group[source]] == 0
    repeated = len(faces) - len(source) - int(doubled.sum())
    dropped = _needless(faces[source], areas[source], doubled, vertices)
    return source[~dropped], doubled[~dropped], repeated, int(dropped.sum())


def _needless(faces: I64, areas: F64, doubled: Mask, vertices: int) -> Mask:
    """Mark doubled faces without which the surface is better closed: walls between two parts that touch, small flaps.

    The two faces of a pair cancel in the winding number. Other doubled faces stay, once: those of a surface that is
    doubled throughout, and those that close a hole.
    """
    if not doubled.any():
        return doubled.copy()
    edges = edges_of(faces, vertices)
    pairs = np.bincount(edges.of[:, doubled].ravel(), minlength=len(edges.count))
    others = edges.count - pairs
    # Clusters of doubled faces that share edges: a graph of faces and edges.
    of = edges.of[:, doubled]
    m = of.shape[1]
    cluster = connected(np.tile(np.arange(m), 3), m + of.ravel(), m + len(edges.count))
    at = np.flatnonzero(pairs)
    owner = cluster[m + at]

    def total(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.asarray(np.bincount(owner, weights=values[at], minlength=cluster.max() + 1))

    attached = total(others > 0) > 0
    better = total(others % 2) <= total((others + pairs) % 2)
    wall = total((others == 0) & (pairs == 1)) == 0
    area = np.bincount(cluster[:m], weights=areas[doubled], minlength=cluster.max() + 1)
    needless = attached & better & (wall | (area <= MOST_FLAP * areas.sum()))
    out = doubled.copy()
    out[doubled] = needless[cluster[:m]]
    return out


def _patches(edges: Edges, areas: F64) -> tuple[I64, Mask]:
    """Find the patch of each face, (M,), and whether to reverse the face so that it looks as most of its patch does."""
    m = edges.of.shape[1]
    of = edges.of.ravel()
    unordered = np.flatnonzero(edges.paired[of])
    halves = unordered[np.argsort(of[unordered], kind="stable")].reshape(-1, 2)
    f, g = (halves % m).T
    agree = edges.net[of[halves[:, 0]]] == 0
    patch = connected(f, g, m)
    if agree.all():
        return patch, np.zeros(m, dtype=bool)
    # Two nodes per face, one as it is and one reversed: a patch that can be oriented has two mirrored components.
    to = np.where(agree, 0, m)
    side = connected(np.concatenate([f, f + m]), np.concatenate([g + to, g + m - to]), 2 * m)
    first = np.unique(patch, return_index=True)[1]
    turned = (side[:m] != side[first][patch]) & (side[:m] != side[m:])
    most = np.bincount(patch, weights=np.where(turned, areas, -areas)) > 0
    return patch, turned ^ (most[patch] & (side[:m] != side[m:]))
