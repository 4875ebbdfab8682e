"""Exact evaluation of one SIREN and of its derivatives in numpy, float32."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import F32
from ..parallel import MULTIPLICATIONS_IN_ONE_THREAD, over_rows

# Values of a layer (points times width) that are evaluated at once: they fit into the processor's cache.
VALUES_AT_ONCE = 2**17


class Network:
    """(u, v) -> (near, far): sine layers sin(omega (W x + b)), then one linear layer."""

    def __init__(self, tensors: Sequence[F32], omega_first: float, omega_hidden: float) -> None:
        """tensors: in the order and shapes of `format.container.tensor_shapes`."""
        matrices, biases = tensors[0::2], tensors[1::2]
        self._max_inputs = max(W.shape[1] for W in matrices)
        omegas = [omega_first] + [omega_hidden] * (len(matrices) - 2) + [1.0]
        # sin(omega (W x + b)) = sin((omega W) x + omega b): one product less per layer.
        self.matrices = [np.ascontiguousarray(W * np.float32(o)) for W, o in zip(matrices, omegas, strict=True)]
        self.biases = [(b * np.float32(o))[:, None] for b, o in zip(biases, omegas, strict=True)]

    def __call__(self, uv: F32) -> F32:
        """(N, 2) float32 -> (N, 2) float32: near and far height.

        Fastest when each column of uv is contiguous. The columns of the result are.
        """
        out = np.empty((2, len(uv)), dtype=np.float32)

        def work(first: int, last: int) -> None:
            x = self._stack(uv[first:last])
            for W, b in zip(self.matrices[:-1], self.biases[:-1], strict=True):
                x = W @ x
                x += b
                np.sin(x, out=x)
            out[:, first:last] = _unstacked(self.matrices[-1] @ x + self.biases[-1], last - first)

        over_rows(work, len(uv), -(-VALUES_AT_ONCE // self._max_inputs))
        return out.T

    def gradient(self, uv: F32) -> tuple[F32, F32]:
        """(N, 2) float32 -> heights (N, 2) and their derivatives (N, 2, 2): [n, k, j] is d height k / d uv j.

        Analytic, by the chain rule from the input on; takes about three times as long as the heights alone.
        """
        heights = np.empty((2, len(uv)), dtype=np.float32)
        derivatives = np.empty((2, 2, len(uv)), dtype=np.float32)

        def work(first: int, last: int) -> None:
            x = self._stack(uv[first:last])
            W, b = self.matrices[0], self.biases[0]
            s = W @ x + b
            x, slope = np.sin(s), np.cos(s)
            du, dv = slope * W[:, :1], slope * W[:, 1:]
            for W, b in zip(self.matrices[1:-1], self.biases[1:-1], strict=True):
                s = W @ x
                s += b
                x, slope = np.sin(s), np.cos(s)
                du, dv = (W @ du) * slope, (W @ dv) * slope
            W, n = self.matrices[-1], last - first
            heights[:, first:last] = _unstacked(W @ x + self.biases[-1], n)
            derivatives[:, 0, first:last] = _unstacked(W @ du, n)
            derivatives[:, 1, first:last] = _unstacked(W @ dv, n)

        over_rows(work, len(uv), -(-VALUES_AT_ONCE // (4 * self._max_inputs)))
        return heights.T, np.moveaxis(derivatives, -1, 0)

    def _stack(self, uv: F32) -> F32:
        """(n, 2) -> (stack, 2, points), padded with zeros.

        Points come last because numpy is fast along long last dimensions; their number is limited so that no product
        starts the threads of BLAS.
        """
        points = min(max(1, MULTIPLICATIONS_IN_ONE_THREAD // self._max_inputs**2), max(1, len(uv)))
        stack = -(-len(uv) // points)
        out = np.zeros((2, stack * points), dtype=np.float32)
        out[:, : len(uv)] = uv.T
        return np.ascontiguousarray(out.reshape(2, stack, points).swapaxes(0, 1))


def _unstacked(x: F32, n: int) -> F32:
    """(stack, 2, points) -> (2, n), without the padding."""
    return x.swapaxes(0, 1).reshape(2, -1)[:, :n]
