"""Polygons to triangles that cover them and nothing else, concave ones too, and use every corner.

A corner on a straight side, where a neighbour may end, has to be one of a triangle with an area, or the surface opens
there. earcut gives such corners triangles of no area in half of the polygons that do not lie along the axes.
"""

from __future__ import annotations

import numpy as np

from .common import F64, I64, check_count

FANS = 64  # corners up to which every fan of a polygon is tried before ears are cut
FLAT = 1e-12  # of the squared size: a corner that turns by less does not turn


def triangulate(vertices: F64, corners: I64, sizes: I64) -> tuple[I64, list[str]]:
    """(T, 3) triangles of polygons, and notes on what could not be done right.

    corners: (K,) vertex numbers, one polygon after another; sizes: (M,) how many belong to each. Every polygon is seen
    along its mean normal (Newell's). Polygons of fewer than three corners are left out, with a note.
    """
    check_count(int(np.maximum(sizes - 2, 0).sum()))
    starts = np.cumsum(sizes) - sizes
    out, crossing = [np.empty((0, 3), dtype=np.int64)], 0
    for n in np.unique(sizes).tolist():
        if n < 3:
            continue
        rows = corners[starts[sizes == n][:, None] + np.arange(n)]
        if n == 3:
            out.append(rows)
            continue
        points = vertices[rows]
        with np.errstate(over="ignore", invalid="ignore"):  # what is too large is told later, with the mesh's size
            flat = _projected(points)
            fans, left = _fans(rows, flat) if n <= FANS else (rows[:0, :3], np.arange(len(rows)))
        out.append(fans)
        for k in left.tolist():
            if not np.isfinite(flat[k]).all():  # kept, for the check of the mesh to refuse
                ears, simple = [(0, j, j + 1) for j in range(1, n - 1)], True
            else:
                ears, simple = _ears(flat[k].tolist())
            crossing += not simple
            out.append(rows[k][np.array(ears, dtype=np.int64).reshape(-1, 3)])
    notes = []
    few = int((sizes < 3).sum())
    if few:
        notes.append(f"{few} faces of fewer than three corners were left out")
    if crossing:
        notes.append(f"{crossing} polygons cross or touch themselves: what they cover was guessed")
    return np.concatenate(out), notes


def _projected(points: F64) -> F64:
    """(M, n, 2) polygons (M, n, 3) as seen along their mean normals, turning to the left; of size about one."""
    points = points - points[:, :1]
    size = np.abs(points).max(axis=(1, 2))
    points = points / np.where(size > 0, size, 1)[:, None, None]
    normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    normal = np.where(length[:, None] > 0, normal / np.where(length > 0, length, 1)[:, None], [0.0, 0, 1])
    helper = np.eye(3)[np.abs(normal).argmin(axis=1)]
    across = np.cross(helper, normal)
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(normal, across)
    return np.stack([np.einsum("mnk,mk->mn", points, across), np.einsum("mnk,mk->mn", points, up)], axis=2)


def _fans(rows: I64, flat: F64) -> tuple[I64, I64]:
    """Triangles of the polygons (M, n) that a fan from one of their corners covers, and the numbers of the others.

    A fan is right when all of its triangles turn to the left and their angles at the corner add up to less than a whole
    turn. Convex polygons are fans from their first corner, as most programs draw them.
    """
    n = rows.shape[1]
    out, left = [rows[:0, :3]], np.arange(len(rows))
    for apex in range(n):
        order = (apex + np.arange(n)) % n
        way = flat[left][:, order[1:]] - flat[left][:, order[:1]]
        a, b = way[:, :-1], way[:, 1:]
        turn = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        angle = np.arctan2(turn, (a * b).sum(axis=2)).sum(axis=1)
        good = (turn > FLAT).all(axis=1) & (angle < 2 * np.pi - 1e-6)
        fan = rows[left[good]][:, order]
        first = np.broadcast_to(fan[:, :1], (len(fan), n - 2))
        out.append(np.stack([first, fan[:, 1:-1], fan[:, 2:]], axis=2).reshape(-1, 3))
        left = left[~good]
        if not len(left):
            break
    return np.concatenate(out), left


def _ears(points: list[list[float]]) -> tuple[list[tuple[int, int, int]], bool]:
    """Triangles (corner numbers) of one polygon by cutting ears, the one with the shortest cut first, and whether all
    were ears: they are of every polygon whose sides do not meet.

    An ear is a corner that turns to the left, and in whose triangle no corner lies that does not.
    """
    x = np.array(points)
    ring = [k for k in range(len(points)) if points[k] != points[k - 1]]  # doubled corners are one
    if len(ring) < 3:
        return [], True
    after = dict(zip(ring, ring[1:] + ring[:1], strict=True))
    before = {b: a for a, b in after.items()}
    turns = {k: _turn(points[before[k]], points[k], points[after[k]]) for k in ring}
    blunt = {k for k in ring if turns[k] <= FLAT}
    cuts = {k: _cut(x, points, before[k], k, after[k], blunt, turns[k]) for k in ring}
    out, simple = [], True
    while len(after) > 3:
        best = min(cuts, key=lambda k: (cuts[k], k))
        if cuts[best] == np.inf:
            # What blocked an ear may have been cut meanwhile. Else: two sides cross, or only flat corners are left.
            cuts = {k: _cut(x, points, before[k], k, after[k], blunt, turns[k]) for k in after}
            best = min(cuts, key=lambda k: (cuts[k], k))
            if cuts[best] == np.inf:
                best = max(turns, key=lambda k: (turns[k], -k))
                simple = simple and all(abs(turn) <= FLAT for turn in turns.values())
        a, c = before[best], after[best]
        out.append((a, best, c))
        after[a], before[c] = c, a
        for gone in (after, before, turns, cuts):
            del gone[best]
        blunt.discard(best)
        for k in (a, c):
            turns[k] = _turn(points[before[k]], points[k], points[after[k]])
            blunt = blunt | {k} if turns[k] <= FLAT else blunt - {k}
        for k in (a, c):
            cuts[k] = _cut(x, points, before[k], k, after[k], blunt, turns[k])
    k = next(iter(after))
    return [*out, (before[k], k, after[k])], simple and turns[k] >= -FLAT


def _turn(a: list[float], b: list[float], c: list[float]) -> float:
    """Twice the area of a triangle, positive when it turns to the left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _cut(x: F64, points: list[list[float]], a: int, b: int, c: int, blunt: set[int], turn: float) -> float:
    """Squared length of the cut from a to c that takes the ear b off, infinite where b is no ear."""
    if turn <= FLAT:
        return np.inf
    near = x[list(blunt)]
    corners = x[[a, b, c]]
    inside = np.ones(len(near), dtype=bool)
    for p, q in ((0, 1), (1, 2), (2, 0)):
        side, way = corners[q] - corners[p], near - corners[p]
        inside &= side[0] * way[:, 1] - side[1] * way[:, 0] >= 0
    inside &= (near[:, None] != corners).any(axis=2).all(axis=1)  # a corner at the same place as one of its own
    if inside.any():
        return np.inf
    return (points[a][0] - points[c][0]) ** 2 + (points[a][1] - points[c][1]) ** 2
