"""Cells of space around a closed mesh: inside, outside, or met by triangles; and the points in them.

A cell that no triangle meets has one winding number. They are counted along lines through the centres of the grid's
columns. A point in a cell that triangles meet is first compared with two parallel planes that hold all of the
surface in that cell between them: beyond either, the winding number is known. Between them, the crossings are counted
on the way along an axis to the nearest free cell.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...arrays import F32, F64, I32, I64, Mask
from .crossings import CrossingTriangles
from .ragged import entries, groups

CELLS_PER_SIDE = 128  # along the longest side of the mesh
# Cells that all triangles together may meet; a mesh of many large triangles gets larger cells.
MOST_MEETINGS = 2**22
PIECE_CELLS = 2.0  # triangles are cut into pieces with sides up to this before their cells are looked for
# Cells' faces are this much farther out when triangles are looked for, in cells: more than float32 rounds positions by.
MARGIN = 2.0**-10
PAIRS_AT_ONCE = 2**16  # of points and triangles: their arrays stay in the processor's cache
POINTS_WORTH_SLABS = 2**16  # points asked for, over all calls, from which on slabs save more time than they take

OUTSIDE, INSIDE, MET = 0, 1, 2  # states of cells
LOW_SIDE, HIGH_SIDE = 1, 2  # bits of a slab: this side of it is inside


class Meetings(NamedTuple):
    """Which triangles meet which cells. cells: (K,) flat numbers, rising. start: (K + 1,) into triangles."""

    cells: I64
    start: I64
    triangles: I64


class Paths(NamedTuple):
    """For each met cell, the way to a free cell. direction: 2 axis + (1 where it rises). start: (K + 1,).

    end: coordinate along the axis at which the way ends, the free cell's centre; winding: the number there. triangles:
    those that the way may cross.
    """

    direction: npt.NDArray[np.int8]
    end: F64
    winding: I64
    start: I64
    triangles: I32


class Slabs(NamedTuple):
    """For each met cell, two parallel planes. planes: (K, 5) unit normal, least and greatest n . x of the surface in
    the cell, x in cells from the cell's centre. sides: (K,) bits."""

    planes: F32
    sides: npt.NDArray[np.uint8]


class CellGrid:
    """The cells around a closed mesh. May be used from several threads at once."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        self._vertices, self._faces = vertices, faces
        self._triangles = CrossingTriangles(vertices, faces)
        lo, hi = vertices.min(axis=0), vertices.max(axis=0)
        span = float((hi - lo).max())
        self.edge = _edge(vertices[faces], span) if span > 0 else 1.0
        # A free cell all around: where points beyond the grid are looked up. Half a cell more, so that the sides of a
        # box, which are common, do not lie on cells' faces, where twice as many cells meet them.
        self.shape = np.floor((hi - lo) / self.edge + 0.5).astype(np.int64) + 3
        self.origin = (lo + hi) / 2 - self.shape / 2 * self.edge
        met = self._meetings()
        winding = self._winding_numbers(met)
        self.states = (winding > 0).astype(np.uint8)
        self.states[met.cells] = MET
        self._met = met
        self._number = np.full(len(winding), -1, np.int32)  # of met cells
        self._number[met.cells] = np.arange(len(met.cells))
        self._paths = self._find_paths(winding)
        self._slabs: Slabs | None = None
        self._points_asked = 0
        self._lock = threading.Lock()

    def contains(self, points: F64) -> Mask:
        """Whether the winding number around points (N, 3) is positive, (N,)."""
        at, fractions = self._locate(points)
        state = self.states.take(at)
        inside = state == INSIDE
        unsure = np.flatnonzero(state == MET)
        cell = self._number.take(at.take(unsure))
        slabs = self._make_slabs(len(points))
        if slabs is not None:
            n = slabs.planes.take(cell, axis=0)
            along = np.zeros(len(unsure), np.float32)
            for k in range(3):
                along += n[:, k] * fractions[k].take(unsure)
            low, high = along < n[:, 3], along > n[:, 4]
            sides = slabs.sides.take(cell)
            inside[unsure] = (low & (sides & LOW_SIDE > 0)) | (high & (sides & HIGH_SIDE > 0))
            between = np.flatnonzero(~(low | high))
            unsure, cell = unsure.take(between), cell.take(between)
        inside[unsure] = self._winding_in_cells(points.take(unsure, axis=0), cell) > 0
        return inside

    def _locate(self, points: F64) -> tuple[npt.NDArray[np.intp], list[F32]]:
        """Flat numbers (N,) of the cells of points (N, 3), and positions in cells from the cells' centres, 3 of (N,)."""
        flat = np.zeros(len(points), np.intp)
        fractions = []
        with np.errstate(invalid="ignore", over="ignore"):
            for k in range(3):
                x = ((points[:, k] - self.origin[k]) / self.edge).astype(np.float32)
                # NaN goes to the border, where all is outside, as what is too far away does.
                x = np.fmax(np.fmin(x, np.float32(self.shape[k] - 0.5)), np.float32(0))
                cell = x.astype(np.int32)
                x -= cell
                x -= np.float32(0.5)
                flat *= self.shape[k]
                flat += cell
                fractions.append(x)
        return flat, fractions

    def _meetings(self) -> Meetings:
        corners = (self._vertices[self._faces] - self.origin) / self.edge  # in cells
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # A normal is as exact as the products that it is a difference of.
        doubt = 1e-12 * np.ptp(corners, axis=1).max(axis=1) ** 2
        pieces, triangle = _in_pieces(corners, PIECE_CELLS)
        lo = np.floor(pieces.min(axis=1) - MARGIN).astype(np.int64)
        hi = np.floor(pieces.max(axis=1) + MARGIN).astype(np.int64)
        n = hi - lo + 1
        found = []
        for first, last in groups(n.prod(axis=1), PAIRS_AT_ONCE):
            part = slice(first, last)
            own, within = entries(np.zeros(last - first, np.int64), n[part].prod(axis=1))
            rest, z = np.divmod(within, n[part, 2].take(own))
            x, y = np.divmod(rest, n[part, 1].take(own))
            cell = np.stack([x, y, z], axis=1) + lo[part].take(own, axis=0)
            t = triangle[part].take(own)
            normal = normals.take(t, axis=0)
            off = np.abs(((cell + 0.5 - pieces[part, 0].take(own, axis=0)) * normal).sum(axis=1))
            meets = np.flatnonzero(off <= (0.5 + MARGIN) * np.abs(normal).sum(axis=1) + doubt.take(t))
            flat = np.ravel_multi_index(tuple(cell[meets].T), tuple(self.shape))
            found.append(flat * len(self._faces) + t[meets])
        cell, t = _distinct(np.concatenate(found), len(self._faces))
        first_of = np.flatnonzero(np.diff(cell, prepend=-1))
        return Meetings(cell[first_of], np.append(first_of, len(cell)), t)

    def _winding_numbers(self, met: Meetings) -> I32:
        """Winding numbers around the centres of all cells; those of met cells mean little."""
        nz = int(self.shape[2])
        cells = np.repeat(met.cells, np.diff(met.start))
        column, t = _distinct(cells // nz * len(self._faces) + met.triangles, len(self._faces))
        i, j = np.divmod(column, self.shape[1])
        u, v = (self.origin[k] + (m + 0.5) * self.edge for k, m in enumerate((i, j)))
        covers = self._triangles.covers(t, u, v, 2)
        crossed = np.flatnonzero(covers)
        t, covers = t.take(crossed), covers.take(crossed)
        z = self._triangles.heights(t, u.take(crossed), v.take(crossed), 2)
        below = np.clip(np.ceil((z - self.origin[2]) / self.edge - 0.5), 0, nz - 1).astype(np.int64)  # centres
        # Centre k has the crossings above it: those that have more than k centres below.
        steps = np.bincount(column.take(crossed) * nz + below, weights=covers, minlength=int(self.shape.prod()))
        steps = steps.reshape(-1, nz)
        return (steps.sum(axis=1, keepdims=True) - np.cumsum(steps, axis=1)).astype(np.int32).ravel()

    def _find_paths(self, winding: I32) -> Paths:
        cells = self._met.cells
        count = np.diff(self._met.start)
        strides = np.array([self.shape[1] * self.shape[2], self.shape[2], 1])
        best = np.full(len(cells), np.iinfo(np.int64).max)
        direction, length = np.zeros(len(cells), np.int8), np.zeros(len(cells), np.int64)
        # Every direction in turn, a cell at a time, while it is cheaper than the best so far. The border ends all.
        for d in range(6):
            step = strides[d // 2] * (1 if d % 2 else -1)
            walker, cost, taken = np.arange(len(cells)), np.zeros(len(cells), np.int64), 0
            while len(walker):
                number = self._number.take(cells.take(walker) + taken * step)
                free = number < 0
                done = walker[free]
                best[done], direction[done], length[done] = cost[free], d, taken
                walker, cost = walker[~free], cost[~free] + count.take(number[~free])
                cheaper = cost < best.take(walker)
                walker, cost = walker[cheaper], cost[cheaper]
                taken += 1
        steps = strides.take(direction // 2) * np.where(direction % 2, 1, -1)
        own, along = entries(np.zeros(len(cells), np.int64), length)
        number = self._number.take(cells.take(own) + along * steps.take(own))
        of, place = entries(self._met.start.take(number), count.take(number))
        of, t = _distinct(own.take(of) * len(self._faces) + self._met.triangles.take(place), len(self._faces))
        last = cells + length * steps
        axis = direction // 2
        index = np.stack(np.unravel_index(last, tuple(self.shape)))[axis, np.arange(len(cells))]
        return Paths(
            direction,
            self.origin.take(axis) + (index + 0.5) * self.edge,
            winding.take(last).astype(np.int64),
            np.searchsorted(of, np.arange(len(cells) + 1)),
            t.astype(np.int32),
        )

    def _winding_in_cells(self, points: F64, cells: npt.NDArray[np.integer]) -> I64:
        """Winding numbers (N,) around points (N, 3) in met cells (N,), given by their place among these."""
        paths = self._paths
        out = paths.winding.take(cells)
        direction = paths.direction.take(cells)
        for d in range(6):
            here = np.flatnonzero(direction == d)
            start = paths.start.take(cells.take(here))
            count = paths.start[1:].take(cells.take(here)) - start
            for first, last in groups(count, PAIRS_AT_ONCE):
                part = here[first:last]
                out[part] += self._crossings(points.take(part, axis=0), cells.take(part), d)
        return out

    def _crossings(self, points: F64, cells: npt.NDArray[np.integer], direction: int) -> I64:
        """Changes (N,) of the winding number from the ends of the paths to points (N, 3)."""
        start = self._paths.start.take(cells)
        own, place = entries(start, self._paths.start[1:].take(cells) - start)
        t = self._paths.triangles.take(place)
        axis = direction // 2
        x = np.ascontiguousarray(points.T)
        covers = self._triangles.covers(t, x[(axis + 1) % 3].take(own), x[(axis + 2) % 3].take(own), axis)
        covered = np.flatnonzero(covers)
        t, own, covers = t.take(covered), own.take(covered), covers.take(covered)
        here = points.take(own, axis=0)
        there = here.copy()
        there[:, axis] = self._paths.end.take(cells.take(own))
        crossed = self._triangles.is_below(t, here, axis) != self._triangles.is_below(t, there, axis)
        sums = np.bincount(own, weights=covers * crossed, minlength=len(points)).astype(np.int64)
        return sums if direction % 2 else -sums

    def _make_slabs(self, points: int) -> Slabs | None:
        if self._slabs is None:
            with self._lock:
                self._points_asked += points
                if self._slabs is None and self._points_asked >= POINTS_WORTH_SLABS:
                    self._slabs = self._find_slabs()
        return self._slabs

    def _find_slabs(self) -> Slabs:
        met = self._met
        count = np.diff(met.start)
        corners = ((self._vertices - self.origin) / self.edge).astype(np.float32)[self._faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        units = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        # The planes' normal: the mean of the triangles', by area up to that of a cell's face.
        weighted = units * np.minimum(lengths, 1)
        n = np.add.reduceat(weighted.take(met.triangles, axis=0), met.start[:-1], axis=0)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        n = np.where(length > 0, n / np.where(length > 0, length, 1), np.float32([0, 0, 1]))
        centres = np.stack(np.unravel_index(met.cells, tuple(self.shape)), axis=1).astype(np.float32) + np.float32(0.5)
        low, high = np.empty(len(n), np.float32), np.empty(len(n), np.float32)
        for first, last in groups(count, PAIRS_AT_ONCE):
            own = np.repeat(np.arange(first, last), count[first:last])
            t = met.triangles[met.start[first] : met.start[last]]
            normal, centre = n.take(own, axis=0), centres.take(own, axis=0)
            a = [((corners[:, k].take(t, axis=0) - centre) * normal).sum(axis=1) for k in range(3)]
            unit = units.take(t, axis=0)
            # In the cell, the triangle's plane has n . x = (n . unit) (unit . a) + (the rest of n) . x.
            cosine = (normal * unit).sum(axis=1)
            middle = cosine * ((corners[:, 0].take(t, axis=0) - centre) * unit).sum(axis=1)
            reach = np.float32(0.5 + MARGIN) * np.abs(normal - cosine[:, None] * unit).sum(axis=1)
            starts = met.start[first:last] - met.start[first]
            low[first:last] = np.minimum.reduceat(np.maximum(np.minimum.reduce(a), middle - reach), starts)
            high[first:last] = np.maximum.reduceat(np.minimum(np.maximum.reduce(a), middle + reach), starts)
        low -= np.float32(MARGIN)
        high += np.float32(MARGIN)
        # The corner that is farthest out on each side, just within the cell, speaks for all of the side.
        corner = np.copysign(np.float32(0.5 - MARGIN), n)
        farthest = (corner * n).sum(axis=1)
        sides = np.zeros(len(n), np.uint8)
        for sign, beyond, bit in ((1, farthest > high, HIGH_SIDE), (-1, -farthest < low, LOW_SIDE)):
            at = np.flatnonzero(beyond)
            points = self.origin + (centres[at] + sign * corner[at]).astype(np.float64) * self.edge
            sides[at] |= np.where(self._winding_in_cells(points, at) > 0, np.uint8(bit), np.uint8(0))
        low[~(-farthest < low)], high[~(farthest > high)] = -np.inf, np.inf
        return Slabs(np.column_stack([n, low, high]), sides)


def _edge(corners: F64, span: float) -> float:
    """Length of a cell's edge, for triangles (M, 3, 3) in a box with sides of at most `span`."""
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    perimeter = np.linalg.norm(sides, axis=2).sum()
    n = CELLS_PER_SIDE
    # A flat triangle meets about 3 cells per cell's face of its area, 2 per edge of its perimeter, and 8 at least.
    while n > 8 and 3 * area * (n / span) ** 2 + 2 * perimeter * n / span + 8 * len(corners) > MOST_MEETINGS:
        n //= 2
    return span / n


def _in_pieces(corners: F64, size: float) -> tuple[F64, I64]:
    """Cut triangles (M, 3, 3) until the sides of their boxes are at most `size`: pieces (K, 3, 3), and of which (K,)."""
    done, numbers = [], []
    number = np.arange(len(corners))
    while len(corners):
        large = np.ptp(corners, axis=1).max(axis=1) > size
        done.append(corners[~large])
        numbers.append(number[~large])
        corners, number = corners[large], number[large]
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).argmax(axis=1)
        a, b, c = (corners[np.arange(len(corners)), (longest + k) % 3] for k in range(3))
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        number = np.concatenate([number, number])
    return np.concatenate(done), np.concatenate(numbers)


def _distinct(keys: I64, n: int) -> tuple[I64, I64]:
    """The two numbers, the second below n, of distinct keys first * n + second, in rising order."""
    keys = np.sort(keys)
    keys = keys[np.diff(keys, prepend=-1) > 0]
    first, second = np.divmod(keys, n)
    return first, second
