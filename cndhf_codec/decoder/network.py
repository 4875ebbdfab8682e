"""Exact evaluation of one SIREN in numpy, float32."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]

# Rows evaluated at once: a layer's activations stay in the processor's cache.
CHUNK = 8192


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
        for at in range(0, len(uv), CHUNK):
            x = uv[at : at + CHUNK]
            for W, b in zip(self.matrices[:-1], self.biases[:-1], strict=True):
                x = x @ W
                x += b
                np.sin(x, out=x)
            out[at : at + CHUNK] = x @ self.matrices[-1] + self.biases[-1]
        return out
