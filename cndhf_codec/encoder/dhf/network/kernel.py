"""Compiled evaluation of networks and the joint loss: forward and backward passes that stay in the processor's cache.

Networks are rows of `theta`, (K, P) float32: K networks of equal depth, the weights of each in file order, and zeros
after those of narrower networks. All functions here release the interpreter's lock, so that threads run side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np

from ....arrays import F32, I64, Mask
from .vectors import LANES, add_outer, set_product, sine_and_cosine, sine_in_place

# Evidence for these constants: ADR 020.
BLOCK_POINTS = 512  # evaluated together: a network's results for so many fit in the cache
NO_FIELD = np.float32(1e3)  # stands for the value of a field that does not matter to a sample; no value is as large


class Net(NamedTuple):
    """One network. theta: (P,). layers: number of sine layers."""

    theta: F32
    width: int
    layers: int
    omega: np.float32


class Tape(NamedTuple):
    """A forward pass, kept for the backward pass. x: (2, BLOCK_POINTS) inputs. outputs, cosines: of every sine layer,
    (layers, width, BLOCK_POINTS)."""

    x: F32
    outputs: F32
    cosines: F32


class Shapes(NamedTuple):
    """Shapes of K networks: widths (K,), numbers of weights (K,), number of sine layers, omegas (K,)."""

    widths: I64
    counts: I64
    layers: int
    omegas: F32


class SurfaceSamples(NamedTuple):
    """N samples of the surface. points: (K, N, 3) in the frame of every field. active: (N, K) which fields could matter
    to the sample. seen: (N, K) which see it. cosine: (N, K) between normal and axis."""

    points: F32
    active: Mask
    seen: Mask
    cosine: F32


class SpaceSamples(NamedTuple):
    """M samples of space. points: (K, M, 3). active: (M, K). excluded: (M, K) which fields' exact heights exclude the
    sample. inside, margin, weight: (M,)."""

    points: F32
    active: Mask
    excluded: Mask
    inside: Mask
    margin: F32
    weight: F32


class LossData(NamedTuple):
    """The data of the joint loss. boxes: (K, 3, 2) domain boxes."""

    shapes: Shapes
    boxes: F32
    surface: SurfaceSamples
    space: SpaceSamples


class Batch(NamedTuple):
    """Samples of one step. surface, space: their rows. surface_scale, space_scale: factor of each sample's cost."""

    surface: I64
    space: I64
    surface_scale: np.float32
    space_scale: np.float32


Function = TypeVar("Function", bound=Callable[..., Any])

# Sums may be taken in another order, so that loops run on vectors.
FREEDOMS = {"contract", "reassoc", "nsz"}


def compiled(function: Function) -> Function:
    """Compile for this processor, for calls from Python."""
    try:
        return numba.njit(cache=True, nogil=True, fastmath=FREEDOMS)(function)
    except RuntimeError:  # there is no folder that a cache could be written to
        return numba.njit(nogil=True, fastmath=FREEDOMS)(function)


def inlined(function: Function) -> Function:
    """Compile into each function that calls it. Compiled on its own, it could be the cache's version or a new one,
    whose sums differ."""
    return numba.njit(nogil=True, fastmath=FREEDOMS, forceinline=True)(function)


@inlined
def arguments(theta: F32, at: int, omega: np.float32, x: F32, z: F32, n: int) -> None:
    """Set z[:, :n] to omega (W x + b) of a sine layer whose weights begin at `at`."""
    width, inputs = len(z), len(x)
    bias = at + width * inputs
    set_product(theta[at:bias].reshape(width, inputs), x, theta[bias : bias + width], omega, z, n)


@inlined
def last_layer(theta: F32, width: int, x: F32, y: F32, n: int) -> None:
    """Set y[:, :n], (2, BLOCK_POINTS), to the heights, from the outputs x of the last sine layer."""
    at = len(theta) - 2 * width - 2
    bias = at + 2 * width
    set_product(theta[at:bias].reshape(2, width), x, theta[bias:], np.float32(1), y, n)


@inlined
def back_through(W: F32, d: F32, e: F32, n: int) -> None:
    """Set e[:, :n] = W^T d[:, :n]: take a gradient back through a layer."""
    set_product(W.T, d, np.zeros(W.shape[1], np.float32), np.float32(1), e, n)


@inlined
def _filled(x: F32, m: int) -> int:
    """Fill the columns m to n of x, where n is a multiple of LANES; their results are not used. Returns n."""
    n = m + -m % LANES
    for c in range(m, n):
        x[0, c], x[1, c] = x[0, 0], x[1, 0]
    return n


@inlined
def evaluate(net: Net, x: F32, n: int, a: F32, b: F32, y: F32) -> None:
    """Set y[:, :n] to the heights at the first n columns of x; both are (2, BLOCK_POINTS).

    Overwrites a and b, (width, BLOCK_POINTS). n is a multiple of LANES, here and below.
    """
    arguments(net.theta, 0, net.omega, x, a, n)
    sine_in_place(a, n)
    at = 3 * net.width
    for _ in range(net.layers - 1):
        arguments(net.theta, at, net.omega, a, b, n)
        sine_in_place(b, n)
        a, b = b, a
        at += net.width * (net.width + 1)
    last_layer(net.theta, net.width, a, y, n)


@inlined
def new_tape(net: Net) -> Tape:
    outputs = np.empty((net.layers, net.width, BLOCK_POINTS), np.float32)
    return Tape(np.empty((2, BLOCK_POINTS), np.float32), outputs, np.empty_like(outputs))


@inlined
def forward(net: Net, tape: Tape, n: int) -> None:
    """Fill the tape for the first n columns of its x."""
    z = np.empty((net.width, BLOCK_POINTS), np.float32)
    arguments(net.theta, 0, net.omega, tape.x, z, n)
    sine_and_cosine(z, tape.outputs[0], tape.cosines[0], n)
    at = 3 * net.width
    for k in range(1, net.layers):
        arguments(net.theta, at, net.omega, tape.outputs[k - 1], z, n)
        sine_and_cosine(z, tape.outputs[k], tape.cosines[k], n)
        at += net.width * (net.width + 1)


@inlined
def backward(net: Net, tape: Tape, n: int, g: F32, grad: F32) -> None:
    """Add to grad, (P,), the gradient of sum(g * heights) over the first n columns. g: (2, BLOCK_POINTS)."""
    width = net.width
    at = len(net.theta) - 2
    for j in range(2):
        total = np.float32(0)
        for t in range(n):
            total += g[j, t]
        grad[at + j] += total
    at -= 2 * width
    add_outer(g, tape.outputs[net.layers - 1], grad[at : at + 2 * width].reshape(2, width), n)
    d, e = np.empty((width, BLOCK_POINTS), np.float32), np.empty((width, BLOCK_POINTS), np.float32)
    back_through(net.theta[at : at + 2 * width].reshape(2, width), g, d, n)
    for k in range(net.layers - 1, -1, -1):
        inputs = 2 if k == 0 else width
        at -= width
        for j in range(width):
            total = np.float32(0)
            for t in range(n):
                d[j, t] *= tape.cosines[k, j, t] * net.omega
                total += d[j, t]
            grad[at + j] += total
        at -= width * inputs
        before = tape.x if k == 0 else tape.outputs[k - 1]
        add_outer(d, before, grad[at : at + width * inputs].reshape(width, inputs), n)
        if k:
            back_through(net.theta[at : at + width * inputs].reshape(width, inputs), d, e, n)
            d, e = e, d


@compiled
def heights(net: Net, uv: F32) -> F32:
    """(N, 2): near and far height at uv, (N, 2)."""
    a, b = np.empty((net.width, BLOCK_POINTS), np.float32), np.empty((net.width, BLOCK_POINTS), np.float32)
    x, y = np.empty((2, BLOCK_POINTS), np.float32), np.empty((2, BLOCK_POINTS), np.float32)
    out = np.empty_like(uv)
    for at in range(0, len(uv), BLOCK_POINTS):
        n = min(BLOCK_POINTS, len(uv) - at)
        for t in range(n):
            x[0, t], x[1, t] = uv[at + t, 0], uv[at + t, 1]
        evaluate(net, x, _filled(x, n), a, b, y)
        for t in range(n):
            out[at + t, 0], out[at + t, 1] = y[0, t], y[1, t]
    return out


@compiled
def heights_gradient(net: Net, uv: F32, g: F32) -> F32:
    """(P,): gradient of sum(g * heights) in theta; uv and g are (N, 2)."""
    tape, d = new_tape(net), np.empty((2, BLOCK_POINTS), np.float32)
    grad = np.zeros(len(net.theta), np.float32)
    for at in range(0, len(uv), BLOCK_POINTS):
        n = min(BLOCK_POINTS, len(uv) - at)
        for t in range(n):
            tape.x[0, t], tape.x[1, t] = uv[at + t, 0], uv[at + t, 1]
            d[0, t], d[1, t] = g[at + t, 0], g[at + t, 1]
        filled = _filled(tape.x, n)
        d[:, n:filled] = 0
        n = filled
        forward(net, tape, n)
        backward(net, tape, n, d, grad)
    return grad


@compiled
def jacobian(net: Net, uv: F32, side: I64) -> F32:
    """(N, P): gradient of height `side` (0 near, 1 far) at every row of uv, (N, 2), in theta."""
    tape, width = new_tape(net), net.width
    d, e = np.empty((width, BLOCK_POINTS), np.float32), np.empty((width, BLOCK_POINTS), np.float32)
    out = np.zeros((len(uv), len(net.theta)), np.float32)
    for start in range(0, len(uv), BLOCK_POINTS):
        n = min(BLOCK_POINTS, len(uv) - start)
        rows = out[start : start + n]
        for t in range(n):
            tape.x[0, t], tape.x[1, t] = uv[start + t, 0], uv[start + t, 1]
        filled = _filled(tape.x, n)
        forward(net, tape, filled)
        at = len(net.theta) - 2 - 2 * width
        for t in range(n):
            s = side[start + t]
            rows[t, len(net.theta) - 2 + s] = 1
            for j in range(width):
                rows[t, at + s * width + j] = tape.outputs[net.layers - 1, j, t]
                d[j, t] = net.theta[at + s * width + j]
        for k in range(net.layers - 1, -1, -1):
            inputs = 2 if k == 0 else width
            before = tape.x if k == 0 else tape.outputs[k - 1]
            bias, at = at - width, at - width - width * inputs
            for j in range(width):
                for t in range(n):
                    d[j, t] *= tape.cosines[k, j, t] * net.omega
            for t in range(n):
                for j in range(width):
                    rows[t, bias + j] = d[j, t]
                    for i in range(inputs):
                        rows[t, at + j * inputs + i] = d[j, t] * before[i, t]
            if k:
                back_through(net.theta[at : at + width * inputs].reshape(width, inputs), d, e, filled)
                d, e = e, d
    return out


@inlined
def _place(point: F32, box: F32, x: F32, m: int) -> None:
    """Set column m of x to where a network is evaluated for a point (3,) of its frame: clamped to the domain box."""
    for c in range(2):
        x[c, m] = min(max(point[c], box[c, 0]), box[c, 1])


@inlined
def joint_gradient(theta: F32, loss: LossData, batch: Batch, grad: F32) -> float:
    """Return the joint loss of a batch, and set grad, (K, P), to its gradient in theta.

    Pass one evaluates all active fields and keeps nothing. Pass two evaluates again the field that answers for a
    sample, and goes back through it.
    """
    shapes, boxes, surface, space = loss
    K, first, total = len(theta), len(batch.surface), len(batch.surface) + len(batch.space)
    widest = shapes.widths.max()
    a, b = np.empty((widest, BLOCK_POINTS), np.float32), np.empty((widest, BLOCK_POINTS), np.float32)
    x, y = np.empty((2, BLOCK_POINTS), np.float32), np.empty((2, BLOCK_POINTS), np.float32)
    value, on_far = np.empty((K, BLOCK_POINTS), np.float32), np.empty((K, BLOCK_POINTS), np.bool_)
    column = np.empty(BLOCK_POINTS, np.int64)
    # For every sample: which field answers, with which height, and the slope of the cost in the field's value.
    field, side, slope = np.empty(total, np.int64), np.empty(total, np.int64), np.zeros(total, np.float32)
    cost = 0.0
    for of_space in range(2):
        samples = batch.space if of_space else batch.surface
        points = space.points if of_space else surface.points
        active = space.active if of_space else surface.active
        for at in range(0, len(samples), BLOCK_POINTS):
            rows = samples[at : at + BLOCK_POINTS]
            n = len(rows)
            for k in range(K):
                m = 0
                for t in range(n):
                    value[k, t] = NO_FIELD
                    if active[rows[t], k]:
                        _place(points[k, rows[t]], boxes[k], x, m)
                        column[m] = t
                        m += 1
                if m == 0:
                    continue
                w = shapes.widths[k]
                net = Net(theta[k, : shapes.counts[k]], w, shapes.layers, shapes.omegas[k])
                evaluate(net, x, _filled(x, m), a[:w], b[:w], y)
                for c in range(m):
                    t = column[c]
                    z = points[k, rows[t], 2]
                    above, below = y[1, c] - z, z - y[0, c]
                    on_far[k, t] = above < below
                    value[k, t] = min(above, below)
            for t in range(n):
                i, s = rows[t], of_space * first + at + t
                least, who = NO_FIELD, 0
                for k in range(K):
                    if value[k, t] < least:
                        least, who = value[k, t], k
                if of_space == 0:
                    if least >= 0:
                        least = NO_FIELD
                        for k in range(K):
                            if surface.seen[i, k] and value[k, t] < least:
                                least, who = value[k, t], k
                    slope[s] = surface.cosine[i, who] * batch.surface_scale * np.sign(least)
                    cost += slope[s] * least
                elif space.inside[i]:
                    if space.margin[i] > least:
                        slope[s] = -space.weight[i] * batch.space_scale
                        cost += slope[s] * (least - space.margin[i])
                else:
                    least = NO_FIELD
                    for k in range(K):
                        if space.excluded[i, k] and value[k, t] < least:
                            least, who = value[k, t], k
                    if space.margin[i] > -least:
                        slope[s] = space.weight[i] * batch.space_scale
                        cost += slope[s] * (least + space.margin[i])
                field[s], side[s] = who, 1 if on_far[who, t] else 0

    grad[:] = 0
    g = np.empty((2, BLOCK_POINTS), np.float32)
    for k in range(K):
        net = Net(theta[k, : shapes.counts[k]], shapes.widths[k], shapes.layers, shapes.omegas[k])
        tape, of_net = new_tape(net), grad[k, : shapes.counts[k]]
        m = 0
        for s in range(total + 1):
            if s < total and field[s] == k and slope[s] != 0:
                point = surface.points[k, batch.surface[s]] if s < first else space.points[k, batch.space[s - first]]
                _place(point, boxes[k], tape.x, m)
                g[side[s], m] = slope[s] * (2 * side[s] - 1)
                g[1 - side[s], m] = 0
                m += 1
            if m == BLOCK_POINTS or (m and s == total):
                n = _filled(tape.x, m)
                g[:, m:n] = 0
                forward(net, tape, n)
                backward(net, tape, n, g, of_net)
                m = 0
    return cost
