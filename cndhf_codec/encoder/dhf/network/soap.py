"""SOAP for small networks: Adam in the eigenbasis of Shampoo's preconditioner.

Vyas et al., "SOAP: Improving and Stabilizing Shampoo using Adam" (2024). Compiled: with matrices as small as
these, calls of a library's functions would cost more than the networks' own forward and backward pass.
"""

from __future__ import annotations

import numpy as np
import torch

from ....arrays import F32, F64, I64, Mask
from .kernel import compiled, inlined
from .siren import Networks
from .vectors import LANES, add_outer, set_product

# Steps that both moments and the preconditioner remember, about. In networks wider than WIDE they are out of date
# sooner: by the fourth power of the width.
MEMORY, LEAST_MEMORY, WIDE = 20.0, 4.0, 24
EPSILON = np.float32(1e-8)
SHIFT = 1e-6  # of the preconditioners' eigenvalues, relative to their largest entry
FIRST_ITERATIONS = 10  # of the eigenbasis, from the first gradient
REFRESH = 10  # steps between refreshes of the eigenbasis

Places = I64  # (K, M, 3): where each matrix starts in a row of theta, its rows and its columns
State = tuple[Places, F32, F32, F32, F32, F32]  # places, fade, grams, bases, first and second moments


class Soap:
    """Steps the weights of some networks in place."""

    def __init__(self, networks: Networks) -> None:
        self._theta = networks.theta.detach()
        self._taken = 0
        places = np.array([_places(networks, k) for k in range(len(networks))])
        widths = np.array(networks.widths)
        memory = np.maximum(MEMORY * np.minimum(1.0, (WIDE / widths) ** 4), LEAST_MEMORY)
        fade = (1 / memory).astype(np.float32)  # (K,)
        first, second = (np.zeros(self._theta.shape, np.float32) for _ in range(2))
        # Of each matrix, for its rows and for its columns; with zeros beyond its size, up to whole vectors.
        side = max(networks.widths) + -max(networks.widths) % LANES
        grams, bases = (np.zeros((*places.shape[:2], 2, side, side), np.float32) for _ in range(2))
        self.state: State = places, fade, grams, bases, first, second

    def step(self, gradient: torch.Tensor, rate: float | F64) -> None:
        """One step along `gradient`, (K, P), at one learning rate or, (K,), at each network's own. The first call only
        sets up the eigenbasis."""
        g = gradient.detach().cpu().numpy()
        if not self.started:
            places, fade, grams, bases, _, _ = self.state
            _first_bases(g, places, fade, grams, bases)
            return
        (scale,), (refresh,) = self.plan(np.broadcast_to(rate, (1, len(g))))
        theta = self._theta.cpu().numpy()
        _move(theta, g.copy(), self.state, scale, refresh)
        self._theta.copy_(torch.from_numpy(theta))

    @property
    def started(self) -> bool:
        """Whether the eigenbases are set up."""
        return bool(self.state[3].any())

    def plan(self, rates: F64) -> tuple[F32, Mask]:
        """Count some steps as taken, at the learning rates (S, K). Returns the scale (S, K) that `move_matrix` takes
        for each of them, and (S,) whether it refreshes the eigenbases."""
        numbers = self._taken + 1 + np.arange(len(rates))
        self._taken += len(rates)
        correction = 1 - (1 - self.state[1].astype(np.float64)) ** numbers[:, None]
        return (rates / correction**0.5).astype(np.float32), numbers % REFRESH == 0


def _places(networks: Networks, k: int) -> list[tuple[int, ...]]:
    shapes = zip(networks.starts(k), networks.shapes(k), strict=True)
    return [(int(start), *shape) for start, shape in shapes if len(shape) == 2]


@inlined
def _product(A: F32, B: F32, out: F32, columns: int) -> None:
    """out[: rows of A, :columns] = A B; overwrites what is beyond, up to whole vectors."""
    none = np.zeros(A.shape[0], np.float32)
    set_product(A, B, none, np.float32(1), out, columns + -columns % LANES)


@inlined
def _load(row: F32, at: int, rows: int, columns: int, out: F32) -> None:
    """The matrix that begins at `at`, with zeros beyond."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = row[at + i * columns + j] if i < rows and j < columns else 0


@inlined
def _store(matrix: F32, row: F32, at: int, rows: int, columns: int) -> None:
    for i in range(rows):
        for j in range(columns):
            row[at + i * columns + j] = matrix[i, j]


@inlined
def _flip(matrix: F32, out: F32) -> None:
    """The transpose."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[j, i] = matrix[i, j]


@inlined
def _add_to_grams(g: F32, rows: int, columns: int, fade: np.float32, left: F32, right: F32) -> None:
    """Move the grams a little towards those of g, (rows, columns) with zeros beyond: g g^T and g^T g."""
    flipped, part = np.empty_like(g), np.empty_like(g)
    _flip(g, flipped)
    for side in range(2):
        gram, of, n = (left, g, rows) if side == 0 else (right, flipped, columns)
        for i in range(n):
            for j in range(n):
                gram[i, j] *= np.float32(1) - fade
            for j in range(g.shape[1]):
                part[i, j] = fade * of[i, j]
        add_outer(part, of, gram[:n, :n], g.shape[1])


@inlined
def _iterate(gram: F32, basis: F32) -> None:
    """One step of orthogonal iteration: the basis becomes an orthonormal one of (gram + shift) basis.

    Gram and Schmidt's method, twice over, in float64: LAPACK's solvers give NaN for some matrices of few numbers that
    are not zero.
    """
    n = len(gram)
    largest = 1e-30
    for i in range(n):
        for j in range(n):
            largest = max(largest, abs(gram[i, j]))
    vectors = np.zeros((n, n))  # one a row
    for c in range(n):
        for j in range(n):
            b = basis[j, c] / largest
            for i in range(n):
                vectors[c, i] += gram[j, i] * b
        for i in range(n):
            vectors[c, i] += SHIFT * basis[i, c]
    for c in range(n):
        for _ in range(2):
            for b in range(c):
                along = 0.0
                for i in range(n):
                    along += vectors[b, i] * vectors[c, i]
                for i in range(n):
                    vectors[c, i] -= along * vectors[b, i]
            square = 0.0
            for i in range(n):
                square += vectors[c, i] * vectors[c, i]
            for i in range(n):
                vectors[c, i] /= np.sqrt(square)
    for c in range(n):
        for i in range(n):
            basis[i, c] = vectors[c, i]


@compiled
def _first_bases(gradient: F32, places: Places, fade: F32, grams: F32, bases: F32) -> None:
    g = np.empty(grams.shape[-2:], np.float32)
    for k in range(len(gradient)):
        for m in range(places.shape[1]):
            at, rows, columns = places[k, m]
            _load(gradient[k], at, rows, columns, g)
            _add_to_grams(g, rows, columns, fade[k], grams[k, m, 0], grams[k, m, 1])
            for side in range(2):
                n = rows if side == 0 else columns
                basis = bases[k, m, side, :n, :n]
                for i in range(n):
                    basis[i, i] = 1
                for _ in range(FIRST_ITERATIONS):
                    _iterate(grams[k, m, side, :n, :n], basis)


@inlined
def _refresh(grams: F32, bases: F32, squares: F32, half: F32, whole: F32) -> None:
    """Bring both eigenbases of a matrix nearer to their grams'; its second moments go along. Overwrites half and
    whole."""
    for side in range(2):
        n = squares.shape[side]
        gram, basis = grams[side, :n, :n], bases[side, :n, :n]
        # Largest eigenvalue first, or the iteration would not converge.
        _product(gram, bases[side], half, n)
        values, order = np.zeros(n, np.float32), np.arange(n)
        for c in range(n):
            for i in range(n):
                values[c] += basis[i, c] * half[i, c]
            place = c
            while place > 0 and values[order[place - 1]] < values[c]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = c
        for of in range(2):
            ordered = basis if of == 0 else squares
            by_row = of == 1 and side == 0
            for i in range(ordered.shape[0]):
                for j in range(ordered.shape[1]):
                    whole[i, j] = ordered[order[i], j] if by_row else ordered[i, order[j]]
            for i in range(ordered.shape[0]):
                for j in range(ordered.shape[1]):
                    ordered[i, j] = whole[i, j]
        _iterate(gram, basis)


@inlined
def move_matrix(
    theta: F32,
    gradient: F32,
    held: Mask,
    k: int,
    m: int,
    state: State,
    scale: np.float32,
    refresh: bool,
) -> None:
    """Step matrix m of network k and the biases after it in theta, (K, P), but for what is held; overwrites their
    gradient. Brings the moments, in the eigenbasis, and the grams up to date, and then the bases where they are to be
    refreshed."""
    places, fade, grams, bases, first, second = state
    work = np.empty((4, *grams.shape[-2:]), np.float32)
    g, half, whole, other = work[0], work[1], work[2], work[3]
    at, rows, columns = places[k, m]
    left, right, row = bases[k, m, 0], bases[k, m, 1], gradient[k]
    # The gradient into the eigenbasis, the move out of it; the first moment out of it and into the new one. A loop, for
    # what is inlined twice takes twice as long to compile.
    for turn in range(4 if refresh else 2):
        source, into = row if turn < 2 else first[k], turn % 3 == 0
        _load(source, at, rows, columns, g)
        if turn == 0:
            _add_to_grams(g, rows, columns, fade[k], grams[k, m, 0], grams[k, m, 1])
        if turn == 3:
            _refresh(grams[k, m], bases[k, m], second[k, at : at + rows * columns].reshape(rows, columns), half, whole)
        if into:
            _load(right.ravel(), 0, right.shape[0], right.shape[1], other)
        else:
            _flip(right, other)
        _product(left[:rows, :rows].T if into else left[:rows, :rows], g, half, columns)
        _product(half[:rows, :columns], other, whole, columns)
        _store(whole, source, at, rows, columns)
        if turn == 0:
            for i in range(at, at + rows * (columns + 1)):
                first[k, i] += fade[k] * (row[i] - first[k, i])
                second[k, i] += fade[k] * (row[i] * row[i] - second[k, i])
                row[i] = scale * first[k, i] / (np.sqrt(second[k, i]) + EPSILON)
        if turn == 1:
            for i in range(at, at + rows * (columns + 1)):
                if not held[k, i]:
                    theta[k, i] -= row[i]


@compiled
def _move(theta: F32, gradient: F32, state: State, scale: F32, refresh: bool) -> None:
    """Step all weights of theta, (K, P); overwrites the gradient."""
    held = np.zeros(theta.shape, np.bool_)
    for k in range(len(theta)):
        for m in range(state[0].shape[1]):
            move_matrix(theta, gradient, held, k, m, state, scale[k], refresh)
