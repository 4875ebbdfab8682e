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
from .crossings import AFTER, CrossingTriangles, Way
from .ragged import entries, groups
from .vectors import cross, dot

CELLS_PER_SIDE = 128  # along the longest side of the mesh
# Large triangles may meet so many cells together, and each of the small ones some 8; else cells become larger. Bounds
# the time and the memory that a mesh can ask for.
MOST_MEETINGS = 2**21
LEAST_PER_SIDE = 4
PIECE_CELLS = 2.0  # triangles are cut into pieces with sides up to this before their cells are looked for
# Cells' faces are this much farther out when triangles are looked for, in cells: more than float32 rounds positions by.
MARGIN = 2.0**-10
# Rounding moves a corner by 3e-14 cells at most; 30 times that and a triangle's size bound the error of its normal.
DOUBT = 1e-12
PAIRS_AT_ONCE = 2**16  # of points and triangles: their arrays stay in the processor's cache
# Points asked for, over all calls, from which on slabs save time when the points are near the surface: they take 0.1 s
# for 50,000 triangles, and save 0.2 microseconds for such a point.
POINTS_WORTH_SLABS = 2**19

OUTSIDE, INSIDE, MET = 0, 1, 2  # states of cells
LOW_SIDE, HIGH_SIDE = 1, 2  # bits of a slab: this side of it is inside


class Meetings(NamedTuple):
    """Which triangles meet which cells. cells: (K,) flat numbers, rising. start: (K + 1,) into triangles."""

    cells: I64
    start: I64
    triangles: I64


class Paths(NamedTuple):
    """For each met cell, the way along an axis to a free cell, and the triangles that it may cross.

    axis: (K,). rises: (K,) whether it goes towards greater coordinates. end: (K,) coordinates of their ends, the free
    cells' centres. winding: (K,) the numbers there. start: (K + 1,) into triangles. boxes: for each of these, in cells,
    least u, greatest u, least v, greatest v, and how far along the way it reaches; u and v are the next axes.
    """

    axis: I64
    rises: Mask
    end: F64
    winding: I64
    start: I64
    triangles: I64
    boxes: list[F32]


class Slabs(NamedTuple):
    """For each met cell, two parallel planes. planes: (K, 5) unit normal, least and greatest n . x of the surface in
    the cell, x in cells from the cell's least corner. sides: (K,) bits."""

    planes: F32
    sides: npt.NDArray[np.uint8]


class CellGrid:
    """The cells around a closed mesh. May be used from several threads at once."""

    def __init__(self, vertices: F64, faces: I64) -> None:
        lo, hi = vertices.min(axis=0), vertices.max(axis=0)
        span = float((hi - lo).max())
        self.edge = _edge(vertices[faces], span) if span > 0 else 1.0
        # A free cell all around: where points beyond the grid are looked up. Half a cell more, so that the sides of a
        # box, which are common, do not lie on cells' faces, where twice as many cells meet them.
        self.shape = np.floor((hi - lo) / self.edge + 0.5).astype(np.int64) + 3
        self.origin = (lo + hi) / 2 - self.shape / 2 * self.edge
        # Triangles in the order of cells: those of a cell, and of the next, are near each other in memory.
        first = ((vertices[faces[:, 0]] - self.origin) / self.edge).astype(np.int64)
        faces = faces[np.argsort(np.ravel_multi_index(tuple(first.T), tuple(self.shape)), kind="stable")]
        self._vertices, self._faces = vertices, faces
        self._triangles = CrossingTriangles(vertices, faces)
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

    def expect(self, points: int) -> None:
        """Say that so many points will be asked for; enough of them, over all calls, are worth slabs."""
        with self._lock:
            self._points_asked += points
            if self._slabs is None and self._points_asked >= POINTS_WORTH_SLABS:
                self._slabs = self._find_slabs()

    def contains(self, points: F64) -> Mask:
        """Whether the winding number around points (N, 3) is positive, (N,)."""
        at, place = self._locate(points)
        state = self.states.take(at)
        inside = state == INSIDE
        unsure = np.flatnonzero(state == MET)
        cell = self._number.take(at.take(unsure))
        place = place.take(unsure, axis=1)
        slabs = self._slabs
        if slabs is not None:
            n = slabs.planes.take(cell, axis=0)
            along = np.zeros(len(cell), np.float32)
            for k in range(3):
                along += n[:, k] * (place[k] - np.floor(place[k]))
            low, high = along < n[:, 3], along > n[:, 4]
            sides = slabs.sides.take(cell)
            inside[unsure] = (low & (sides & LOW_SIDE > 0)) | (high & (sides & HIGH_SIDE > 0))
            between = np.flatnonzero(~(low | high))
            # Cell by cell: what a cell needs is read once.
            between = between[np.argsort(cell.take(between))]
            unsure, cell, place = unsure.take(between), cell.take(between), place.take(between, axis=1)
        inside[unsure] = self._winding_in_cells(points.take(unsure, axis=0), place, cell) > 0
        return inside

    def _locate(self, points: F64) -> tuple[npt.NDArray[np.intp], F32]:
        """Flat numbers (N,) of the cells of points (N, 3), and positions (3, N) in cells from the grid's corner."""
        flat = np.zeros(len(points), np.intp)
        place = np.empty((3, len(points)), np.float32)
        with np.errstate(invalid="ignore", over="ignore"):
            for k in range(3):
                x = points[:, k] - self.origin[k]
                x /= self.edge
                place[k] = x
                # As an unsigned number, what is below zero or not finite is huge, or 0: a cell of the border.
                cell = place[k].astype(np.int32).view(np.uint32)
                flat *= self.shape[k]
                flat += np.minimum(cell, np.uint32(self.shape[k] - 1), out=cell)
        return flat, place

    def _corners(self) -> F64:
        """Corners (3, 3, M) of the triangles, by corner and coordinate, in cells."""
        places = ((self._vertices[:, k] - self.origin[k]) / self.edge for k in range(3))
        return np.stack([x[self._faces.T] for x in places], axis=1)

    def _meetings(self) -> Meetings:
        corners = self._corners()
        normals = cross(corners[1] - corners[0], corners[2] - corners[0])
        sizes = (_greatest(corners) - _least(corners)).max(axis=0)
        reach = (0.5 + MARGIN) * np.abs(normals).sum(axis=0) + DOUBT * sizes * (1 + sizes)
        pieces, triangle = _in_pieces(corners, PIECE_CELLS)
        offset = (normals.take(triangle, axis=1) * (pieces[0] - 0.5)).sum(axis=0)
        lo = np.floor(_least(pieces) - MARGIN).astype(np.int64)
        n = np.floor(_greatest(pieces) + MARGIN).astype(np.int64) - lo + 1
        found = []
        for first, last in groups(n.prod(axis=0), PAIRS_AT_ONCE):
            part = slice(first, last)
            own, within = entries(np.zeros(last - first, np.int64), n[:, part].prod(axis=0))
            rest, z = np.divmod(within, n[2, part].take(own))
            x, y = np.divmod(rest, n[1, part].take(own))
            t = triangle[part].take(own)
            off = -offset[part].take(own)
            flat = np.zeros(len(own), np.int64)
            for k, cell in enumerate((x, y, z)):
                cell += lo[k, part].take(own)
                off += cell * normals[k].take(t)
                flat *= self.shape[k]
                flat += cell
            meets = np.flatnonzero(np.abs(off) <= reach.take(t))
            found.append(flat.take(meets) * len(self._faces) + t.take(meets))
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
        axis, rises = direction.astype(np.int64) // 2, direction % 2 > 0
        index = np.stack(np.unravel_index(last, tuple(self.shape)))[axis, np.arange(len(cells))]
        corners = self._corners()
        lo, hi = (
            (_least(corners) - MARGIN).astype(np.float32).ravel(),
            (_greatest(corners) + MARGIN).astype(np.float32).ravel(),
        )
        boxes = []
        for after in AFTER:
            at = after.take(axis).take(of) * len(self._faces) + t
            boxes += [lo.take(at), hi.take(at)]
        at = axis.take(of) * len(self._faces) + t
        boxes.append(np.where(rises.take(of), hi.take(at), -lo.take(at)))
        return Paths(
            axis,
            rises,
            self.origin.take(axis) + (index + 0.5) * self.edge,
            winding.take(last).astype(np.int64),
            np.searchsorted(of, np.arange(len(cells) + 1)),
            t,
            boxes,
        )

    def _winding_in_cells(self, points: F64, place: F32, cells: npt.NDArray[np.integer]) -> I64:
        """Winding numbers (N,) around points (N, 3) in met cells (N,), given by their number among these.

        place: (3, N) the points' positions as `_locate` gives them.
        """
        paths = self._paths
        axis, rises = paths.axis.take(cells), paths.rises.take(cells)
        start = paths.start.take(cells)
        count = paths.start[1:].take(cells) - start
        each = np.arange(len(cells))
        place = place.ravel()
        axes = [axis, *(after.take(axis) for after in AFTER)]
        z, u, v = (place.take(k * len(cells) + each) for k in axes)
        z = np.where(rises, z, -z)
        x = points.ravel()
        exact_z, exact_u, exact_v = (x.take(3 * each + k) for k in axes)
        change = np.empty(len(cells))
        for first, last in groups(count, PAIRS_AT_ONCE):
            own, entry = entries(start[first:last], count[first:last])
            # First, the triangles' boxes: most triangles of a cell are not on the point's way.
            least_u, greatest_u, least_v, greatest_v, reach = (box.take(entry) for box in paths.boxes)
            at = u[first:last].take(own)
            near = (least_u <= at) & (greatest_u >= at)
            at = v[first:last].take(own)
            near &= (least_v <= at) & (greatest_v >= at)
            near &= reach >= z[first:last].take(own)
            kept = np.flatnonzero(near)
            own, t = own.take(kept) + first, paths.triangles.take(entry.take(kept))
            way_u, way_v, along = exact_u.take(own), exact_v.take(own), axis.take(own)
            covers = self._triangles.covers(t, way_u, way_v, along)
            kept = np.flatnonzero(covers)
            own = own.take(kept)
            way = Way(way_u.take(kept), way_v.take(kept), exact_z.take(own), paths.end.take(cells.take(own)))
            crossed = self._triangles.between(t.take(kept), way, along.take(kept))
            sums = np.bincount(own - first, weights=covers.take(kept) * crossed, minlength=last - first)
            change[first:last] = sums
        # Towards greater coordinates, a triangle that faces that way is left.
        return paths.winding.take(cells) + np.where(rises, change, -change).astype(np.int64)

    def _find_slabs(self) -> Slabs:
        met = self._met
        count = np.diff(met.start)
        wide = self._corners()
        normals = cross(wide[1] - wide[0], wide[2] - wide[0])
        lengths = np.sqrt(dot(normals, normals))
        sizes = (_greatest(wide) - _least(wide)).max(axis=0)
        # Of length one; none for a triangle so thin that rounding turns its normal by more than the margin allows.
        thin = lengths <= 1e4 * DOUBT * sizes * (1 + sizes)
        units = np.where(thin, 0, normals / np.where(thin, 1, lengths)).astype(np.float32)
        corners_of = wide.astype(np.float32)
        # The planes' normal: the mean of the triangles', by area up to that of a cell's face.
        weighted = units * np.minimum(lengths, 1).astype(np.float32)
        n = np.add.reduceat(weighted.take(met.triangles, axis=1), met.start[:-1], axis=1)
        length = np.sqrt((n**2).sum(axis=0))
        n = np.where(length > 0, n / np.where(length > 0, length, 1), np.array([[0], [0], [1]], np.float32))
        centres = np.stack(np.unravel_index(met.cells, tuple(self.shape))).astype(np.float32) + np.float32(0.5)
        low, high = np.empty((2, len(count)), np.float32)
        for first, last in groups(count, PAIRS_AT_ONCE):
            own = np.repeat(np.arange(first, last), count[first:last])
            t = met.triangles[met.start[first] : met.start[last]]
            normal, unit, centre = n.take(own, axis=1), units.take(t, axis=1), centres.take(own, axis=1)
            corners = corners_of.take(t, axis=2) - centre
            along = (corners * normal).sum(axis=1)
            # In the cell, the triangle's plane has n . x = (n . unit) (unit . a) + (the rest of n) . x.
            cosine = (normal * unit).sum(axis=0)
            middle = cosine * (corners[0] * unit).sum(axis=0)
            reach = np.float32(0.5 + MARGIN) * np.abs(normal - cosine * unit).sum(axis=0)
            starts = met.start[first:last] - met.start[first]
            low[first:last] = np.minimum.reduceat(np.maximum(along.min(axis=0), middle - reach), starts)
            high[first:last] = np.maximum.reduceat(np.minimum(along.max(axis=0), middle + reach), starts)
        low -= np.float32(MARGIN)
        high += np.float32(MARGIN)
        # The corner that is farthest out on each side, just within the cell, speaks for all of the side.
        corner = np.copysign(np.float32(0.5 - MARGIN), n)
        farthest = (corner * n).sum(axis=0)
        sides = np.zeros(len(count), np.uint8)
        for sign, beyond, bit in ((1, farthest > high, HIGH_SIDE), (-1, -farthest < low, LOW_SIDE)):
            at = np.flatnonzero(beyond)
            place = centres[:, at] + sign * corner[:, at]
            points = self.origin + place.T.astype(np.float64) * self.edge
            sides[at] |= np.where(self._winding_in_cells(points, place, at) > 0, np.uint8(bit), np.uint8(0))
        low[~(-farthest < low)], high[~(farthest > high)] = -np.inf, np.inf
        # From here on, from the cell's least corner.
        middle = n.sum(axis=0) / 2
        low += middle
        high += middle
        return Slabs(np.column_stack([*n, low, high]), sides)


def _edge(corners: F64, span: float) -> float:
    """Length of a cell's edge, for triangles (M, 3, 3) in a box with sides of at most `span`."""
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    perimeter = np.linalg.norm(sides, axis=2).sum()
    n = CELLS_PER_SIDE
    # A triangle meets about 3 cells per cell's face of its area, and 2 per edge of its perimeter.
    while n > LEAST_PER_SIDE and 3 * area * (n / span) ** 2 + 2 * perimeter * n / span > MOST_MEETINGS:
        n //= 2
    return span / n


def _in_pieces(corners: F64, size: float) -> tuple[F64, I64]:
    """Cut triangles (3, 3, M) until the sides of their boxes are at most `size`: pieces (3, 3, K), of which (K,)."""
    done, numbers = [], []
    number = np.arange(corners.shape[2])
    while len(number):
        large = (_greatest(corners) - _least(corners)).max(axis=0) > size
        done.append(corners[:, :, ~large])
        numbers.append(number[~large])
        corners, number = corners[:, :, large], number[large]
        longest = ((corners - corners[[1, 2, 0]]) ** 2).sum(axis=1).argmax(axis=0)
        a, b, c = (np.take_along_axis(corners, ((longest + k) % 3)[None, None], axis=0)[0] for k in range(3))
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c]), np.stack([middle, b, c])], axis=2)
        number = np.concatenate([number, number])
    return np.concatenate(done, axis=2), np.concatenate(numbers)


def _least(corners: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Least corners (3, N) of the boxes of triangles (3, 3, N)."""
    return np.minimum(np.minimum(corners[0], corners[1]), corners[2])


def _greatest(corners: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Greatest corners (3, N) of the boxes of triangles (3, 3, N)."""
    return np.maximum(np.maximum(corners[0], corners[1]), corners[2])


def _distinct(keys: I64, n: int) -> tuple[I64, I64]:
    """The two numbers, the second below n, of distinct keys first * n + second, in rising order."""
    keys = np.sort(keys)
    keys = keys[np.diff(keys, prepend=-1) > 0]
    first = keys // n
    return first, keys - first * n
