"""SOAP for small networks: Adam in the eigenbasis of Shampoo's preconditioner.

Vyas et al., "SOAP: Improving and Stabilizing Shampoo using Adam" (2024). It is compiled here: with matrices as small as
these, calls of a library's functions would take more time than the networks' own forward and backward pass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from ....arrays import F32, F64, I64, Mask
from .kernel import compiled, inlined
from .siren import Networks
from .vectors import LANES, add_outer, set_product

# Evidence for these constants: ADR 019.
#
# About how many steps moments and preconditioners remember. In networks wider than FULL_MEMORY_WIDTH they are out of
# date sooner, so these remember fewer, by the fourth power of the width.
MEMORY, LEAST_MEMORY, FULL_MEMORY_WIDTH = 20.0, 4.0, 24
EPSILON = np.float32(1e-8)
SHIFT = 1e-6  # of the preconditioners' eigenvalues, relative to their largest entry
FIRST_ITERATIONS = 10  # of the orthogonal iteration that starts the eigenbasis
EIGENBASIS_EVERY = 10  # steps between refreshes of the eigenbasis

# Phases of `soap_update`: take the gradient into the eigenbasis, and the update out of it. Where the eigenbasis is
# refreshed, also take the first moment out of the old one and into the new one.
GRADIENT_IN, UPDATE_OUT, MOMENT_OUT, MOMENT_IN = range(4)


class State(NamedTuple):
    """The state of SOAP for K networks of M matrices each.

    places: (K, M, 3) where each matrix begins in a row of theta, its rows and its columns. decay: (K,) share of the
    preconditioners and moments that a step replaces. preconditioners, eigenbases: (K, M, 2, S, S) for the rows and for
    the columns of each matrix, with zeros beyond its size. first, second: (K, P) moments, in the eigenbasis.
    """

    places: I64
    decay: F32
    preconditioners: F32
    eigenbases: F32
    first: F32
    second: F32


class Soap:
    """The optimiser of some networks, whose weights it changes in place."""

    def __init__(self, networks: Networks) -> None:
        self._theta = networks.theta.detach()
        self._taken = 0
        places = np.array([_places(networks, k) for k in range(len(networks))])
        widths = np.array(networks.widths)
        memory = np.maximum(MEMORY * np.minimum(1.0, (FULL_MEMORY_WIDTH / widths) ** 4), LEAST_MEMORY)
        decay = (1 / memory).astype(np.float32)
        first, second = (np.zeros(self._theta.shape, np.float32) for _ in range(2))
        # Rounded up to whole vectors.
        side = max(networks.widths) + -max(networks.widths) % LANES
        preconditioners, eigenbases = (np.zeros((*places.shape[:2], 2, side, side), np.float32) for _ in range(2))
        self.state = State(places, decay, preconditioners, eigenbases, first, second)

    def start(self, gradient: torch.Tensor) -> None:
        """Set up the eigenbases from the first gradient, (K, P); the weights stay as they are."""
        _first_eigenbases(gradient.detach().numpy(), self.state)

    def step(self, gradient: torch.Tensor, rate: float | F64) -> None:
        """Take a step along `gradient`, (K, P), at one learning rate, or at one for each network, (K,). The first call
        only sets up the eigenbases."""
        if not self.started:
            self.start(gradient)
            return
        (scale,), (refresh,) = self.plan(np.broadcast_to(rate, (1, len(gradient))))
        _update_all(self._theta.numpy(), gradient.detach().numpy().copy(), self.state, scale, refresh)

    @property
    def started(self) -> bool:
        """Whether the eigenbases are set up."""
        return bool(self.state.eigenbases.any())

    def plan(self, rates: F64) -> tuple[F32, Mask]:
        """Count S steps as taken, at learning rates (S, K). Returns the scales (S, K) for `soap_update`, and whether it
        refreshes the eigenbases, (S,)."""
        numbers = self._taken + 1 + np.arange(len(rates))
        self._taken += len(rates)
        correction = 1 - (1 - self.state.decay.astype(np.float64)) ** numbers[:, None]
        return (rates / correction**0.5).astype(np.float32), numbers % EIGENBASIS_EVERY == 0


def _places(networks: Networks, k: int) -> list[tuple[int, ...]]:
    shapes = zip(networks.starts(k), networks.shapes(k), strict=True)
    return [(int(start), *shape) for start, shape in shapes if len(shape) == 2]


@inlined
def _product(A: F32, B: F32, out: F32, columns: int) -> None:
    """Set out[: rows of A, :columns] = A B. Overwrites further columns, up to whole vectors."""
    none = np.zeros(A.shape[0], np.float32)
    set_product(A, B, none, np.float32(1), out, columns + -columns % LANES)


@inlined
def _load(row: F32, at: int, rows: int, columns: int, out: F32) -> None:
    """Set `out` to the matrix that begins at `at`, with zeros beyond its size."""
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
    """Set `out` to the transpose."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[j, i] = matrix[i, j]


@inlined
def _update_preconditioners(g: F32, rows: int, columns: int, decay: np.float32, left: F32, right: F32) -> None:
    """Move the preconditioners a little towards g g^T and g^T g; g is (rows, columns) with zeros beyond."""
    flipped, part = np.empty_like(g), np.empty_like(g)
    _flip(g, flipped)
    for side in range(2):
        preconditioner, of, n = (left, g, rows) if side == 0 else (right, flipped, columns)
        for i in range(n):
            for j in range(n):
                preconditioner[i, j] *= np.float32(1) - decay
            for j in range(g.shape[1]):
                part[i, j] = decay * of[i, j]
        add_outer(part, of, preconditioner[:n, :n], g.shape[1])


@inlined
def _iterate(matrix: F32, basis: F32) -> None:
    """Take a step of orthogonal iteration: set `basis` to an orthonormal basis of (matrix + shift) basis.

    By Gram-Schmidt, twice, in float64: LAPACK's solvers give NaN for some matrices that are mostly zero.
    """
    n = len(matrix)
    largest = 1e-30
    for i in range(n):
        for j in range(n):
            largest = max(largest, abs(matrix[i, j]))
    vectors = np.zeros((n, n))  # one per row
    for c in range(n):
        for j in range(n):
            b = basis[j, c] / largest
            for i in range(n):
                vectors[c, i] += matrix[j, i] * b
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
def _first_eigenbases(gradient: F32, state: State) -> None:
    decay, preconditioners, eigenbases = state.decay, state.preconditioners, state.eigenbases
    g = np.empty(preconditioners.shape[-2:], np.float32)
    for k in range(len(gradient)):
        for m in range(state.places.shape[1]):
            at, rows, columns = state.places[k, m]
            _load(gradient[k], at, rows, columns, g)
            _update_preconditioners(g, rows, columns, decay[k], preconditioners[k, m, 0], preconditioners[k, m, 1])
            for side in range(2):
                n = rows if side == 0 else columns
                basis = eigenbases[k, m, side, :n, :n]
                for i in range(n):
                    basis[i, i] = 1
                for _ in range(FIRST_ITERATIONS):
                    _iterate(preconditioners[k, m, side, :n, :n], basis)


@inlined
def _refresh(preconditioners: F32, eigenbases: F32, squares: F32, half: F32, whole: F32) -> None:
    """Bring both eigenbases of a matrix nearer to those of its preconditioners, and sort its second moments alike.
    Overwrites half and whole."""
    for side in range(2):
        n = squares.shape[side]
        preconditioner, basis = preconditioners[side, :n, :n], eigenbases[side, :n, :n]
        # Largest eigenvalue first, or the iteration would not converge.
        _product(preconditioner, eigenbases[side], half, n)
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
        _iterate(preconditioner, basis)


@inlined
def soap_update(
    theta: F32, gradient: F32, held: Mask, k: int, m: int, state: State, scale: np.float32, refresh: bool
) -> None:
    """Take a step with matrix m of network k and the biases after it, in theta, (K, P), except for held weights.

    Updates the moments, in the eigenbasis, the preconditioners, and, with `refresh`, the eigenbases. Overwrites the
    gradient of the matrix and the biases.
    """
    decay, first, second = state.decay[k], state.first, state.second
    preconditioners, eigenbases = state.preconditioners[k, m], state.eigenbases[k, m]
    work = np.empty((4, *preconditioners.shape[-2:]), np.float32)
    g, half, whole, other = work[0], work[1], work[2], work[3]
    at, rows, columns = state.places[k, m]
    left, right, row = eigenbases[0], eigenbases[1], gradient[k]
    # A loop over phases: code that is inlined twice takes twice as long to compile.
    for phase in range(MOMENT_IN + 1 if refresh else UPDATE_OUT + 1):
        source = row if phase <= UPDATE_OUT else first[k]
        _load(source, at, rows, columns, g)
        if phase == GRADIENT_IN:
            _update_preconditioners(g, rows, columns, decay, preconditioners[0], preconditioners[1])
        if phase == MOMENT_IN:
            squares = second[k, at : at + rows * columns].reshape(rows, columns)
            _refresh(preconditioners, eigenbases, squares, half, whole)
        into = phase in (GRADIENT_IN, MOMENT_IN)
        if into:
            _load(right.ravel(), 0, right.shape[0], right.shape[1], other)
        else:
            _flip(right, other)
        _product(left[:rows, :rows].T if into else left[:rows, :rows], g, half, columns)
        _product(half[:rows, :columns], other, whole, columns)
        _store(whole, source, at, rows, columns)
        if phase == GRADIENT_IN:
            for i in range(at, at + rows * (columns + 1)):
                first[k, i] += decay * (row[i] - first[k, i])
                second[k, i] += decay * (row[i] * row[i] - second[k, i])
                row[i] = scale * first[k, i] / (np.sqrt(second[k, i]) + EPSILON)
        if phase == UPDATE_OUT:
            for i in range(at, at + rows * (columns + 1)):
                if not held[k, i]:
                    theta[k, i] -= row[i]


@compiled
def _update_all(theta: F32, gradient: F32, state: State, scale: F32, refresh: bool) -> None:
    """Take a step with all weights of theta, (K, P). Overwrites the gradient."""
    held = np.zeros(theta.shape, np.bool_)
    for k in range(len(theta)):
        for m in range(state.places.shape[1]):
            soap_update(theta, gradient, held, k, m, state, scale[k], refresh)
