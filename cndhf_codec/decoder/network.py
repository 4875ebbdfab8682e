"""Exact evaluation of one SIREN and of its derivatives in numpy, float32."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .parallel import over_rows

F32 = npt.NDArray[np.float32]

# Rows evaluated at once: a layer's activations stay in the processor's cache.
CHUNK = 8192
# A chunk's product is a stack of products of at most this many multiplications, which BLAS does not share out
# among threads of its own: they would get in the way of ours.
PRODUCT = 2**18


class Network:
    """(u, v) -> (near, far): sine layers sin(omega (W x + b)), then one linear layer."""

    def __init__(self, tensors: Sequence[F32], omega_first: float, omega_hidden: float) -> None:
        """tensors: as `format.container.tensor_shapes` orders and shapes them."""
        matrices, biases = tensors[0::2], tensors[1::2]
        omegas = [omega_first] + [omega_hidden] * (len(matrices) - 2) + [1.0]
        # omega is folded into the tensors, and the matrices transposed, once.
        self.matrices = [np.ascontiguousarray((W * np.float32(o)).T) for W, o in zip(matrices, omegas, strict=True)]
        self.biases = [b * np.float32(o) for b, o in zip(biases, omegas, strict=True)]

    def __call__(self, uv: F32) -> F32:
        """(N, 2) float32 -> (N, 2) float32: near and far height."""
        out = np.empty((len(uv), 2), dtype=np.float32)

        def work(first: int, last: int) -> None:
            x = self._stack(uv[first:last])
            for W, b in zip(self.matrices[:-1], self.biases[:-1], strict=True):
                x = x @ W
                x += b
                np.sin(x, out=x)
            out[first:last] = (x @ self.matrices[-1] + self.biases[-1]).reshape(-1, 2)[: last - first]

        over_rows(work, len(uv), CHUNK)
        return out

    def gradient(self, uv: F32) -> tuple[F32, F32]:
        """(N, 2) float32 -> heights (N, 2) and their derivatives (N, 2, 2): [n, k, j] is d height k / d uv j.

        Analytic, by the chain rule from the input on; some three times the cost of the heights alone.
        """
        heights = np.empty((len(uv), 2), dtype=np.float32)
        derivatives = np.empty((len(uv), 2, 2), dtype=np.float32)

        def work(first: int, last: int) -> None:
            x = self._stack(uv[first:last])
            W, b = self.matrices[0], self.biases[0]
            s = x @ W + b
            x, slope = np.sin(s), np.cos(s)
            du, dv = slope * W[0], slope * W[1]
            for W, b in zip(self.matrices[1:-1], self.biases[1:-1], strict=True):
                s = x @ W
                s += b
                x, slope = np.sin(s), np.cos(s)
                du, dv = (du @ W) * slope, (dv @ W) * slope
            W = self.matrices[-1]
            n = last - first
            heights[first:last] = (x @ W + self.biases[-1]).reshape(-1, 2)[:n]
            derivatives[first:last, :, 0] = (du @ W).reshape(-1, 2)[:n]
            derivatives[first:last, :, 1] = (dv @ W).reshape(-1, 2)[:n]

        over_rows(work, len(uv), CHUNK)
        return heights, derivatives

    def _stack(self, uv: F32) -> F32:
        """(n, 2) -> (stack, rows, 2), filled up with zeros."""
        widest = max(W.shape[0] for W in self.matrices)
        rows = min(max(1, PRODUCT // widest**2), max(1, len(uv)))
        stack = -(-len(uv) // rows)
        if stack * rows == len(uv):
            return uv.reshape(stack, rows, 2)
        out = np.zeros((stack, rows, 2), dtype=np.float32)
        out.reshape(-1, 2)[: len(uv)] = uv
        return out
