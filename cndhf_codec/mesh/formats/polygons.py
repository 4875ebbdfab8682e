"""Divide polygons, concave ones too, into triangles that cover them and nothing else, and use every corner.

A corner on a straight side, where a neighbour may end, must belong to a triangle with an area, or the surface opens
there. earcut gives such corners triangles without area in half of the polygons that do not lie along the axes.
"""

from __future__ import annotations

import bisect
import heapq
import itertools

import numpy as np

from ...arrays import F64, I64
from .common import check_count

FANS = 64  # corners up to which every fan of a polygon is tried before ears are cut
FEW = 24  # numbers that Python tests sooner than numpy
FLAT = 1e-12  # of the squared size: a corner that turns by less counts as straight


def triangulate(vertices: F64, corners: I64, sizes: I64) -> tuple[I64, list[str]]:
    """Divide polygons into triangles (T, 3); return also notes on what could not be done right.

    corners: (K,) vertex numbers, one polygon after another. sizes: (M,) how many belong to each. Every polygon is
    projected along its mean normal (Newell's). Polygons of fewer than three corners are left out, with a note.
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
        with np.errstate(over="ignore", invalid="ignore"):  # too large numbers are reported with the mesh's size
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
    """Project polygons (M, n, 3) along their mean normals, to (M, n, 2): they turn left, and their size is about 1."""
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
    """Divide polygons (M, n) that a fan from one of their corners covers; return also the numbers of the others.

    A fan is right when all of its triangles turn left and their angles at the corner add up to less than a whole turn.
    Convex polygons become fans from their first corner, as most programs draw them.
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
    """Divide one polygon by cutting ears, the one with the shortest cut first.

    An ear is a corner that turns left and whose triangle holds no corner that does not. Returns triangles of corner
    numbers, and whether all were ears, as in every polygon whose sides do not meet.
    """
    ring = [k for k in range(len(points)) if points[k] != points[k - 1]]  # repeated corners count once
    if len(ring) < 3:
        return [], True
    after = dict(zip(ring, ring[1:] + ring[:1], strict=True))
    before = {b: a for a, b in after.items()}
    turns = {k: _turn(points[before[k]], points[k], points[after[k]]) for k in ring}
    blunt = _Blunt(points)
    for k in ring:
        if turns[k] <= FLAT:
            blunt.add(k)
    cuts: dict[int, float] = {}  # squared lengths of cuts, infinite where a corner is no ear
    waiting: list[tuple[float, int]] = []  # a heap of the finite cuts, and of some that are out of date
    blocked: dict[int, list[int]] = {}  # place of a blunt corner -> corners that it keeps from being ears
    freed: set[int] = set()  # corners that may be ears, since what blocked them is no longer blunt

    def look(k: int) -> None:
        cuts[k] = np.inf
        if turns[k] > FLAT:
            a, c = before[k], after[k]
            within = blunt.within(a, k, c)
            if within is not None:
                blocked.setdefault(within, []).append(k)
            else:
                cuts[k] = (points[a][0] - points[c][0]) ** 2 + (points[a][1] - points[c][1]) ** 2
                heapq.heappush(waiting, (cuts[k], k))

    def shortest() -> int | None:
        while waiting and cuts.get(waiting[0][1]) != waiting[0][0]:
            heapq.heappop(waiting)
        return waiting[0][1] if waiting else None

    for k in ring:
        look(k)
    out: list[tuple[int, int, int]] = []
    simple = True
    while len(after) > 3:
        best = shortest()
        if best is None:
            for k in freed:
                if k in after:
                    look(k)
            freed.clear()
            best = shortest()
        if best is None:  # two sides cross, or only flat corners are left
            simple = simple and all(abs(turn) <= FLAT for turn in turns.values())
            if len(after) > FANS:
                rest = [k := next(iter(after)), *(k := after[k] for _ in range(len(after) - 1))]
                return [*out, *((rest[0], b, c) for b, c in itertools.pairwise(rest[1:]))], False
            best = max(turns, key=lambda k: (turns[k], -k))
        a, c = before[best], after[best]
        out.append((a, best, c))
        after[a], before[c] = c, a
        for gone in (after, before, turns, cuts):
            del gone[best]
        for k in (a, c):
            turns[k] = _turn(points[before[k]], points[k], points[after[k]])
        for k in (a, best, c):
            if turns.get(k, np.inf) <= FLAT:
                blunt.add(k)
            elif (place := blunt.discard(k)) is not None:
                freed.update(blocked.pop(place, ()))
        for k in (a, c):
            look(k)
    k = next(iter(after))
    return [*out, (before[k], k, after[k])], simple and turns[k] >= -FLAT


def _turn(a: list[float], b: list[float], c: list[float]) -> float:
    """Twice the area of a triangle, positive when it turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


class _Blunt:
    """The places of a polygon's blunt corners, which do not turn left, sorted by their first coordinates."""

    def __init__(self, points: list[list[float]]) -> None:
        places = sorted({(x, y) for x, y in points})
        number = {place: k for k, place in enumerate(places)}
        self._of = [number[x, y] for x, y in points]
        self._places, self._x = places, [x for x, _ in places]
        self._array = np.array(places).T.copy()
        self._at = [set[int]() for _ in places]
        self._any = bytearray(len(places))  # whether the place has a blunt corner
        self._mask = np.frombuffer(self._any, dtype=np.bool_)

    def add(self, corner: int) -> None:
        place = self._of[corner]
        self._at[place].add(corner)
        self._any[place] = 1

    def discard(self, corner: int) -> int | None:
        """Forget a corner; return its place, if this was the last blunt corner there."""
        place = self._of[corner]
        if corner not in self._at[place]:
            return None
        self._at[place].remove(corner)
        self._any[place] = bool(self._at[place])
        return None if self._at[place] else place

    def within(self, a: int, b: int, c: int) -> int | None:
        """Find a place of blunt corners in the triangle of these corners, other than their own places."""
        own = [self._of[k] for k in (a, b, c)]
        (ax, ay), (bx, by), (cx, cy) = (self._places[k] for k in own)
        begin = bisect.bisect_left(self._x, min(ax, bx, cx) - FLAT)
        end = bisect.bisect_right(self._x, max(ax, bx, cx) + FLAT)
        if self._any.count(1, begin, end) > FEW:
            x, y = self._array[:, begin:end]
            inside = self._mask[begin:end] & ((bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0)
            inside &= (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
            inside &= (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
            return next((k for k in (begin + np.flatnonzero(inside)[:4]).tolist() if k not in own), None)
        k = self._any.find(1, begin, end)
        while k >= 0:
            x, y = self._places[k]
            if (
                (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
                and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
                and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
                and k not in own
            ):
                return k
            k = self._any.find(1, k + 1, end)
        return None
