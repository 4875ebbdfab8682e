"""SOAP for networks of equal shape: Adam in the eigenbasis of Shampoo's preconditioner.

Vyas et al., "SOAP: Improving and Stabilizing Shampoo using Adam" (2024). Compiled: with matrices as small as
these, calls of a library's functions would cost more than the networks' own forward and backward pass.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch

from .kernel import F32, add_product, compiled, inlined
from .siren import Networks

# Steps that both moments and the preconditioner remember, about. In networks wider than WIDE they are out of date
# sooner: by the fourth power of the width.
MEMORY, LEAST_MEMORY, WIDE = 20.0, 4.0, 24
EPSILON = np.float32(1e-8)
SHIFT = 1e-6  # of the preconditioners' eigenvalues, relative to their largest entry
FIRST_ITERATIONS = 10  # of the eigenbasis, from the first gradient
REFRESH = 10  # steps between refreshes of the eigenbasis

Places = npt.NDArray[np.int64]  # (M, 3): where each matrix starts in a row of theta, its rows and its columns


class Soap:
    """Steps the weights of some networks in place."""

    def __init__(self, networks: Networks) -> None:
        self._theta = networks.theta.detach()
        starts = np.cumsum([0, *networks.sizes])
        self._places = np.array([(starts[i], *shape) for i, shape in enumerate(networks.shapes) if len(shape) == 2])
        self._step = 0
        self._fade = np.float32(1 / max(MEMORY * min(1.0, (WIDE / networks.width) ** 4), LEAST_MEMORY))
        self._first, self._second = (np.zeros(self._theta.shape, np.float32) for _ in range(2))
        # Of each matrix, for its rows and for its columns; what is beyond its size is not used.
        shape = (len(networks), len(self._places), 2, networks.width, networks.width)
        self._grams, self._bases = (np.zeros(shape, np.float32) for _ in range(2))

    def step(self, gradient: torch.Tensor, rate: float) -> None:
        """One step along `gradient`, (K, P). The first call only sets up the eigenbasis."""
        g = gradient.detach().cpu().numpy()
        if not self._bases.any():
            _first_bases(g, self._places, self._fade, self._grams, self._bases)
            return
        self._step += 1
        correction = 1 - (1 - float(self._fade)) ** self._step
        scale = np.float32(rate * correction**0.5 / correction)
        refresh = self._step % REFRESH == 0
        state = self._grams, self._bases, self._first, self._second
        move = _move(g, self._places, self._fade, *state, scale, refresh)
        self._theta.sub_(torch.from_numpy(move).to(self._theta.device))


@inlined
def _product(A: F32, B: F32, out: F32) -> None:
    """out[: rows of A, : columns of B] = A B."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            out[i, j] = 0
    add_product(A, B, out, B.shape[1])


@inlined
def _add_to_grams(g: F32, fade: np.float32, left: F32, right: F32) -> None:
    """Move the grams a little towards those of g: g g^T and g^T g."""
    rows, columns = g.shape
    for i in range(rows):
        for j in range(rows):
            left[i, j] *= np.float32(1) - fade
    add_product(fade * g, g.T.copy(), left, rows)
    for i in range(columns):
        for j in range(columns):
            right[i, j] *= np.float32(1) - fade
    add_product(fade * g.T.copy(), g, right, columns)


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
def _first_bases(gradient: F32, places: Places, fade: np.float32, grams: F32, bases: F32) -> None:
    for k in range(len(gradient)):
        for m in range(len(places)):
            at, rows, columns = places[m]
            g = gradient[k, at : at + rows * columns].reshape(rows, columns)
            _add_to_grams(g, fade, grams[k, m, 0], grams[k, m, 1])
            for side in range(2):
                n = rows if side == 0 else columns
                basis = bases[k, m, side, :n, :n]
                for i in range(n):
                    basis[i, i] = 1
                for _ in range(FIRST_ITERATIONS):
                    _iterate(grams[k, m, side, :n, :n], basis)


@compiled
def _move(
    gradient: F32,
    places: Places,
    fade: np.float32,
    grams: F32,
    bases: F32,
    first: F32,
    second: F32,
    scale: np.float32,
    refresh: bool,
) -> F32:
    """(K, P): what a step takes from the weights. Brings the moments, in the eigenbasis, and the grams up to date, and
    then the bases where they are to be refreshed."""
    K, P = gradient.shape
    move, rotated = np.empty((K, P), np.float32), gradient.copy()
    width = grams.shape[-1]
    half, whole = np.empty((width, width), np.float32), np.empty((width, width), np.float32)
    for k in range(K):
        for m in range(len(places)):
            at, rows, columns = places[m]
            g = gradient[k, at : at + rows * columns].reshape(rows, columns)
            _add_to_grams(g, fade, grams[k, m, 0], grams[k, m, 1])
            _product(bases[k, m, 0, :rows, :rows].T.copy(), g, half)
            to = rotated[k, at : at + rows * columns].reshape(rows, columns)
            _product(half[:rows, :columns], bases[k, m, 1, :columns, :columns], to)
        for i in range(P):
            first[k, i] += fade * (rotated[k, i] - first[k, i])
            second[k, i] += fade * (rotated[k, i] * rotated[k, i] - second[k, i])
            move[k, i] = scale * first[k, i] / (np.sqrt(second[k, i]) + EPSILON)
        for m in range(len(places)):
            at, rows, columns = places[m]
            left, right = bases[k, m, 0, :rows, :rows], bases[k, m, 1, :columns, :columns]
            to = move[k, at : at + rows * columns].reshape(rows, columns)
            _product(left, to, half)
            _product(half[:rows, :columns], right.T.copy(), to)
            if refresh:
                moment = first[k, at : at + rows * columns].reshape(rows, columns)
                _product(left, moment, half)
                _product(half[:rows, :columns], right.T.copy(), whole)
                squares = second[k, at : at + rows * columns].reshape(rows, columns)
                for side in range(2):
                    n = rows if side == 0 else columns
                    gram, basis = grams[k, m, side, :n, :n], bases[k, m, side, :n, :n]
                    # Largest eigenvalue first, or the iteration would not converge.
                    values = np.empty(n, np.float32)
                    _product(gram, basis, half)
                    for c in range(n):
                        values[c] = 0
                        for i in range(n):
                            values[c] -= basis[i, c] * half[i, c]
                    order = np.argsort(values, kind="mergesort")
                    basis[:] = basis.copy()[:, order]
                    squares[:] = squares.copy()[order] if side == 0 else squares.copy()[:, order]
                    _iterate(gram, basis)
                _product(left.T.copy(), whole[:rows, :columns], half)
                _product(half[:rows, :columns], right, moment)
    return move
