"""Round control vertices to the grid, each so that the others can make up for it (Babai's nearest plane).

Rounding moves the surface by little, and small moves of either sign change the mean distance by a quadratic form: the
density of signed distances at zero is about 1 / (2 mean), whatever their size, so all samples weigh 1 / mean
(`fit.linearised(even=True)`). Vertices are rounded one after the other. When one is, those around it that are still
free move to where the form is least, given what is fixed. So an error across the surface is answered by the
neighbours, and only what none of them can mend remains: at a given error the grid may be 2 to 4 times as coarse.

Mechanical parts have faces along the axes, and a coordinate that a neighbour has takes hardly a bit. So one that no
neighbour has pays a price: a vertex that can slide along its faces goes to where a neighbour's coordinate is.

When all are rounded, single coordinates still move by steps of the grid where that lowers the form, set up anew at the
rounded surface (`polished`). It takes a fifth to a third off what rounding costs.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from ...arrays import F64, I32, I64, Mask
from .basis import Basis
from .fit import linearised
from .target import Target

# Evidence for these constants: ADR 036.
MOST_FREE = 32  # vertices that make up for one; a vertex of six neighbours shares samples with 18 others
POLISHINGS, SWEEPS = 2, 3  # how often the form is set up anew, and how often all coordinates are visited then
FARTHEST = 2.0  # steps of the grid at once: the form holds nearby only
DAMPING = 1e-3  # relative to the diagonal's mean: the form of a vertex that no sample sees is not definite


class Rounding:
    """The rounding of one fit, to any step.

    stiffness: u, where an error x of a coordinate adds u x^2 / 2 to the mean distance when all others make up for it;
    geometric mean over coordinates, for distances that are spread as exp(-d / mean). mean: of the distances. median: of
    the distances, over ln 2, which is the mean where they are so spread.
    """

    def __init__(self, basis: Basis, target: Target, control: F64) -> None:
        normal = linearised(basis, target, control, even=True)
        self._matrix, self._control = normal.matrix, control
        self._damping = DAMPING * self._matrix.diagonal().mean()
        self.stiffness = math.exp(self._run(control.copy(), 0.0))
        self.mean, self.median = normal.mean, normal.median / math.log(2)

    def to(self, step: float, price: float = 0.0) -> I64:
        """(V, 3) grid coordinates. price: of a coordinate that no neighbour has, as mean distance. All that share
        samples with a vertex are its neighbours here; a file repeats those of faces nearby, most of them."""
        places = self._control.copy()
        self._run(places, step, price)
        return np.rint(places / step).astype(np.int64)

    def _run(self, places: F64, step: float, price: float = 0.0) -> float:
        m = self._matrix
        return float(_round(m.indptr, m.indices, m.data, self._damping, step, price, places))


def polished(basis: Basis, target: Target, grid: I64, step: float, price: float = 0.0) -> I64:
    """(V, 3) grid coordinates, each moved by steps of the grid to where the mean distance and the price, as
    `Rounding.to` has it, are least."""
    grid = grid.copy()
    for _ in range(POLISHINGS):
        normal = linearised(basis, target, np.asarray(step * grid, dtype=np.float64), even=True)
        m = normal.matrix
        damping = DAMPING * m.diagonal().mean()
        _move(m.indptr, m.indices, m.data, damping, step, price, -normal.side.reshape(-1, 3), grid)
    return grid


@nb.njit(cache=True)
def _nearest(wish: float, unit: float, price: float, near: F64) -> np.int64:
    """The grid coordinate of least cost: unit d^2 at a distance d from the wish, and the price if no neighbour has it.
    near: the neighbours' coordinates."""
    best = np.int64(np.rint(wish))
    least = price + unit * (best - wish) ** 2
    for c in np.rint(near):
        cost = unit * (c - wish) ** 2
        if cost < least:
            least, best = cost, np.int64(c)
    return best


@nb.njit(cache=True)
def _near(indptr: I32, indices: I32, v: int, coordinates: I64 | F64, counted: Mask) -> F64:
    """The coordinates of those neighbours of v that are counted."""
    out, n = np.empty(indptr[v + 1] - indptr[v]), 0
    for p in range(indptr[v], indptr[v + 1]):
        w = indices[p]
        if w != v and counted[w]:
            out[n] = coordinates[w]
            n += 1
    return out[:n]


@nb.njit(cache=True)
def _meets(indptr: I32, indices: I32, v: int, place: I64 | F64, places: I64 | F64, counted: Mask, half: float) -> bool:
    """Whether one of the neighbours of v that are counted is at this place, less than half a step off."""
    for p in range(indptr[v], indptr[v + 1]):
        w = indices[p]
        if w != v and counted[w] and np.abs(places[w] - place).max() < half:
            return True
    return False


@nb.njit(cache=True)
def _move(
    indptr: I32, indices: I32, blocks: F64, damping: float, step: float, price: float, gradient: F64, grid: I64
) -> None:
    """Move grid coordinates (V, 3) one after the other to where the form is least, given the others. gradient: (V, 3)
    of the form, kept up to date."""
    counted, nothing = np.ones(len(grid), dtype=np.bool_), np.empty(0)
    for _ in range(SWEEPS):
        for v in range(len(grid)):
            own = indptr[v]
            while indices[own] != v:
                own += 1
            for k in range(3):
                form = blocks[own, k, k] + damping
                wish = -gradient[v, k] / (form * step)
                wish = grid[v, k] + min(max(wish, -FARTHEST), FARTHEST)
                near = _near(indptr, indices, v, grid[:, k], counted) if price > 0 else nothing
                move = _nearest(wish, form * step * step / 2, price, near) - grid[v, k]
                if move == 0:
                    continue
                grid[v, k] += move
                if price > 0 and _meets(indptr, indices, v, grid[v], grid, counted, 0.5):
                    grid[v, k] -= move
                    continue
                gradient[v, k] += damping * move * step
                for p in range(indptr[v], indptr[v + 1]):
                    for x in range(3):
                        gradient[indices[p], x] += blocks[p, k, x] * move * step


@nb.njit(cache=True)
def _round(indptr: I32, indices: I32, blocks: F64, damping: float, step: float, price: float, places: F64) -> float:
    """Move places (V, 3) onto the grid, in their order; step 0: leave them. Returns the mean logarithm of stiffness."""
    n = len(places)
    logs = 0.0
    gradient = np.zeros((n, 3))
    done, nothing = np.zeros(n, dtype=np.bool_), np.empty(0)
    number = np.full(n, -1)
    free, ties = np.empty(n, dtype=np.int64), np.empty(n)
    for v in range(n):
        # The vertex and the free ones that share samples with it, those most tied to it; the vertex last.
        m = 0
        for p in range(indptr[v], indptr[v + 1]):
            w = indices[p]
            if w != v and not done[w]:
                free[m] = w
                ties[m] = -np.abs(blocks[p]).sum()
                m += 1
        if m > MOST_FREE:
            free[:m] = free[:m][np.argsort(ties[:m])]
            m = MOST_FREE
        free[m] = v
        m += 1
        for i in range(m):
            number[free[i]] = i
        form, slope = np.zeros((3 * m, 3 * m)), np.zeros(3 * m)
        for i in range(m):
            w = free[i]
            slope[3 * i : 3 * i + 3] = gradient[w]
            for p in range(indptr[w], indptr[w + 1]):
                j = number[indices[p]]
                if j >= 0:
                    form[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = blocks[p]
            for k in range(3):
                form[3 * i + k, 3 * i + k] += damping
        root = np.linalg.cholesky(form)
        size, rest = 3 * m, 3 * m - 3
        # Where the vertex would go were all free; its coordinates are rounded last to first, each given those before.
        y = slope.copy()
        for i in range(size):
            for j in range(i):
                y[i] -= root[i, j] * y[j]
            y[i] /= root[i, i]
        move, asked = np.zeros(size), price
        while True:
            for k in range(2, -1, -1):
                i = rest + k
                wish = -y[i]
                for j in range(k + 1, 3):
                    wish -= root[rest + j, i] * move[rest + j]
                wish /= root[i, i]
                logs += 2 * np.log(root[i, i])
                if step > 0:
                    unit = (root[i, i] * step) ** 2 / 2
                    near = _near(indptr, indices, v, places[:, k], done) / step if asked > 0 else nothing
                    move[i] = _nearest((places[v, k] + wish) / step, unit, asked, near) * step - places[v, k]
            # A vertex must not repeat all coordinates of another.
            if asked == 0 or not _meets(indptr, indices, v, places[v] + move[rest:], places, done, step / 2):
                break
            asked = 0.0
        if step == 0:
            for i in range(m):
                number[free[i]] = -1
            done[v] = True
            continue
        # The free ones: form_rr x = -(slope_r + form_rv move_v).
        for i in range(rest):
            s = slope[i]
            for j in range(rest, size):
                s += form[i, j] * move[j]
            move[i] = -s
        for i in range(rest):
            for j in range(i):
                move[i] -= root[i, j] * move[j]
            move[i] /= root[i, i]
        for i in range(rest - 1, -1, -1):
            for j in range(i + 1, rest):
                move[i] -= root[j, i] * move[j]
            move[i] /= root[i, i]
        for i in range(m):
            w = free[i]
            number[w] = -1
            d = move[3 * i : 3 * i + 3]
            places[w] += d
            gradient[w] += damping * d
            for p in range(indptr[w], indptr[w + 1]):
                for x in range(3):
                    for z in range(3):
                        gradient[indices[p], x] += blocks[p, z, x] * d[z]
        done[v] = True
    return logs / (3 * n)
