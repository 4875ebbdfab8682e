"""SOAP for networks of equal shape: Adam in the eigenbasis of Shampoo's preconditioner, all matrices in one batch.

Vyas et al., "SOAP: Improving and Stabilizing Shampoo using Adam" (2024). A library's would step matrix by matrix; with
matrices as small as these that costs more than the networks' own forward and backward pass.
"""

from __future__ import annotations

import torch

from .siren import Networks

BETA = 0.95  # of both moments and of the preconditioner
EPSILON = 1e-8
SHIFT = 1e-6  # of the preconditioners' eigenvalues, relative to their largest entry
FIRST_ITERATIONS = 10  # of the eigenbasis, from the first gradient
REFRESH = 10  # steps between refreshes of the eigenbasis


class Soap:
    """Steps the weights of some networks in place."""

    def __init__(self, networks: Networks) -> None:
        theta = networks.theta.detach()
        self._theta, self._networks = theta, networks
        self._step = 0
        self._first, self._second = torch.zeros_like(theta), torch.zeros_like(theta)
        views = matrices(theta, networks)
        self._grams = [[_zeros(v, v.shape[-2]), _zeros(v, v.shape[-1])] for v in views]
        self._bases: list[list[torch.Tensor]] = []

    def step(self, gradient: torch.Tensor, rate: float) -> None:
        """One step along `gradient`, (K, P). The first call only sets up the eigenbasis."""
        views = matrices(gradient, self._networks)
        for (left, right), g in zip(self._grams, views, strict=True):
            left.lerp_(g @ g.mT, 1 - BETA)
            right.lerp_(g.mT @ g, 1 - BETA)
        if not self._bases:
            self._bases = [[_eigenbasis(gram) for gram in pair] for pair in self._grams]
            return
        self._step += 1
        rotated = self._rotate(gradient)
        self._first.lerp_(rotated, 1 - BETA)
        self._second.lerp_(rotated.square_(), 1 - BETA)
        correction = 1 - BETA**self._step
        scale = rate * correction**0.5 / correction
        move = self._rotate_back(self._first / self._second.sqrt().add_(EPSILON))
        self._theta.sub_(move, alpha=scale)
        if self._step % REFRESH == 0:
            self._refresh()

    def _refresh(self) -> None:
        """One step of orthogonal iteration on every eigenbasis; the moments go along."""
        unrotated = self._rotate_back(self._first)
        seconds = matrices(self._second, self._networks)
        for pair, bases, second in zip(self._grams, self._bases, seconds, strict=True):
            for side, gram in enumerate(pair):
                basis = bases[side]
                # Largest first, or the iteration would not converge.
                order = (basis * (gram @ basis)).sum(dim=-2).argsort(dim=-1, descending=True)
                basis = basis.gather(-1, order[..., None, :].expand_as(basis))
                index = order[..., :, None] if side == 0 else order[..., None, :]
                second.copy_(second.gather(-2 if side == 0 else -1, index.expand_as(second)))
                bases[side] = torch.linalg.qr(_scaled(gram) @ basis)[0]
        self._first = self._rotate(unrotated)

    def _rotate(self, flat: torch.Tensor) -> torch.Tensor:
        out = flat.clone()
        for (left, right), v in zip(self._bases, matrices(out, self._networks), strict=True):
            v.copy_(left.mT @ v @ right)
        return out

    def _rotate_back(self, flat: torch.Tensor) -> torch.Tensor:
        out = flat.clone()
        for (left, right), v in zip(self._bases, matrices(out, self._networks), strict=True):
            v.copy_(left @ v @ right.mT)
        return out


def matrices(flat: torch.Tensor, networks: Networks) -> list[torch.Tensor]:
    """Views of the first, the hidden and the last matrices in (K, P): (K, layers, outputs, inputs) each."""
    (K, P), width = flat.shape, networks.width
    out, at = [], 0
    for rows, columns, layers in ((width, 2, 1), (width, width, networks.hidden_layers), (2, width, 1)):
        shape, strides = (K, layers, rows, columns), (P, rows * columns + rows, columns, 1)
        out.append(flat.as_strided(shape, strides, flat.storage_offset() + at))
        at += layers * (rows * columns + rows)
    return out


def _zeros(view: torch.Tensor, side: int) -> torch.Tensor:
    return torch.zeros((*view.shape[:2], side, side), device=view.device)


def _eigenbasis(grams: torch.Tensor) -> torch.Tensor:
    """About the eigenvectors, by orthogonal iteration: LAPACK's solvers give NaN for some matrices of few numbers that
    are not zero, as the first gradient's are."""
    scaled = _scaled(grams)
    basis = torch.eye(grams.shape[-1], device=grams.device).expand_as(grams)
    for _ in range(FIRST_ITERATIONS):
        basis = torch.linalg.qr(scaled @ basis)[0]
    return basis


def _scaled(grams: torch.Tensor) -> torch.Tensor:
    """The same eigenvectors, for entries of about 1 and no eigenvalue of 0."""
    largest = grams.abs().amax(dim=(-2, -1), keepdim=True).clamp(min=1e-30)
    return grams / largest + SHIFT * torch.eye(grams.shape[-1], device=grams.device)
