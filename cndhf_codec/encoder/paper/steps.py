"""Adam's steps on the paper's loss, compiled: one network, on tiles of its height images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F32, F64, I64
from ..dhf.network.kernel import BLOCK_POINTS, Net, Tape, backward, compiled, forward, inlined, last_layer, new_tape

# Kingma and Ba, "Adam: A Method for Stochastic Optimization" (2015), with its values.
BETA_1, BETA_2, EPSILON = 0.9, 0.999, np.float32(1e-8)

# Pixels along the side of a tile, of which the inner ones have a Laplacian. The smaller the tiles, the more of them are
# in a batch, and the less its gradient varies (ADR 034).
TILE_SIDE = 4


class TileImages(NamedTuple):
    """A field's targets. uv, heights, known, laplacians: (nu, nv, 2). hit, laplacian_known: (nu, nv). known and hit are
    0 or 1."""

    uv: F32
    heights: F32
    known: F32
    hit: F32
    laplacians: F32
    laplacian_known: F32


class Weights(NamedTuple):
    """margin: C, outside the silhouette the far height shall be this much below the near one. laplacian: weight of the
    loss on the Laplacians."""

    margin: np.float32
    laplacian: np.float32


class Moments(NamedTuple):
    """Of Adam: (P,) each."""

    first: F32
    second: F32


@inlined
def _tile_gradient(y: F32, at: int, images: TileImages, tile: I64, weights: Weights, tiles: int, g: F32) -> float:
    """g[:, at:]: gradient of the loss in the heights y[:, at:] of one of `tiles` tiles, whose first pixel is `tile`.
    Returns the tile's part of the loss."""
    each = np.float32(1.0 / (tiles * TILE_SIDE * TILE_SIDE))
    inner = np.float32(weights.laplacian / (tiles * (TILE_SIDE - 2) * (TILE_SIDE - 2)))
    loss = 0.0
    for a in range(TILE_SIDE):
        for b in range(TILE_SIDE):
            t, i, j = at + a * TILE_SIDE + b, tile[0] + a, tile[1] + b
            for c in range(2):
                error = y[c, t] - images.heights[i, j, c]
                slope = np.sign(error) * images.known[i, j, c] * each
                g[c, t] = slope
                loss += slope * error
            over = y[1, t] - y[0, t] + weights.margin
            if images.hit[i, j] == 0 and over > 0:
                g[1, t] += each
                g[0, t] -= each
                loss += each * over
    for a in range(1, TILE_SIDE - 1):
        for b in range(1, TILE_SIDE - 1):
            t, i, j = at + a * TILE_SIDE + b, tile[0] + a, tile[1] + b
            if images.laplacian_known[i, j] == 0:
                continue
            for c in range(2):
                laplacian = y[c, t + TILE_SIDE] + y[c, t - TILE_SIDE] + y[c, t + 1] + y[c, t - 1] - 4 * y[c, t]
                error = laplacian - images.laplacians[i, j, c]
                slope = np.sign(error) * inner
                g[c, t + TILE_SIDE] += slope
                g[c, t - TILE_SIDE] += slope
                g[c, t + 1] += slope
                g[c, t - 1] += slope
                g[c, t] -= 4 * slope
                loss += slope * error
    return loss


@inlined
def _gradient(net: Net, tape: Tape, images: TileImages, tiles: I64, weights: Weights, grad: F32) -> float:
    """The loss of tiles (T, 2), and grad, (P,): its gradient."""
    points = TILE_SIDE * TILE_SIDE
    together = BLOCK_POINTS // points
    y, g = np.empty((2, BLOCK_POINTS), np.float32), np.empty((2, BLOCK_POINTS), np.float32)
    grad[:] = 0
    loss = 0.0
    for first in range(0, len(tiles), together):
        count = min(together, len(tiles) - first)
        for k in range(count):
            for a in range(TILE_SIDE):
                for b in range(TILE_SIDE):
                    t = k * points + a * TILE_SIDE + b
                    uv = images.uv[tiles[first + k, 0] + a, tiles[first + k, 1] + b]
                    tape.x[0, t], tape.x[1, t] = uv[0], uv[1]
        n = count * points
        forward(net, tape, n)
        last_layer(net.theta, net.width, tape.outputs[net.layers - 1], y, n)
        for k in range(count):
            loss += _tile_gradient(y, k * points, images, tiles[first + k], weights, len(tiles), g)
        backward(net, tape, n, g, grad)
    return loss


@compiled
def gradient(net: Net, images: TileImages, tiles: I64, weights: Weights) -> tuple[float, F32]:
    """The loss of tiles (T, 2), and its gradient, (P,)."""
    grad = np.empty(len(net.theta), np.float32)
    return _gradient(net, new_tape(net), images, tiles, weights, grad), grad


@compiled
def adam_steps(
    net: Net, moments: Moments, taken: int, images: TileImages, tiles: I64, rates: F64, weights: Weights
) -> float:
    """Change net.theta in place by S steps on tiles (S, T, 2), at rates (S,). taken: steps before these. Returns the
    mean loss."""
    tape, grad = new_tape(net), np.empty(len(net.theta), np.float32)
    total = 0.0
    for s in range(len(tiles)):
        total += _gradient(net, tape, images, tiles[s], weights, grad)
        number = taken + s + 1
        first_correction = 1 - BETA_1**number
        second_correction = np.sqrt(1 - BETA_2**number)
        scale = np.float32(rates[s] * second_correction / first_correction)
        epsilon = np.float32(EPSILON * second_correction)
        for i in range(len(grad)):
            moments.first[i] += (np.float32(1) - np.float32(BETA_1)) * (grad[i] - moments.first[i])
            moments.second[i] += (np.float32(1) - np.float32(BETA_2)) * (grad[i] * grad[i] - moments.second[i])
            net.theta[i] -= scale * moments.first[i] / (np.sqrt(moments.second[i]) + epsilon)
    return total / max(len(tiles), 1)
