"""The networks and the composite loss, compiled: forward and backward passes that stay in the cache.

Networks are rows of `theta`, (K, P) float32: K networks with as many layers, the weights of each in file order, and
zeros after those of narrower networks. Everything here is called with the interpreter's lock released, so that threads
run side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

from ....arrays import F32, I64, Mask
from .vectors import LANES, add_outer, set_product, sine_and_cosine, sine_in_place

TILE = 512  # points evaluated at once: what a network computes for them stays in the cache
FAR = np.float32(1e3)  # stands for "no such double height field"

# Of K networks: widths (K,), numbers of weights (K,), sine layers, omegas (K,).
Shape = tuple[I64, I64, int, F32]
# Of N samples of the surface: points (K, N, 3), near (N, K), seen (N, K), cosine (N, K). Networks that are not near a
# sample have no say in what it costs.
OnSurface = tuple[F32, Mask, Mask, F32]
# Of M of space: points (K, M, 3), near (M, K), excluded (M, K), inside (M,), margin (M,), weight (M,).
InSpace = tuple[F32, Mask, Mask, Mask, F32, F32]

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
    """Compile as a part of each function that calls it. As a function of its own, shared by what comes from the cache
    and what is compiled anew, it could be either's version, and its sums differ with that."""
    return numba.njit(nogil=True, fastmath=FREEDOMS, forceinline=True)(function)


@inlined
def arguments(theta: F32, at: int, omega: np.float32, x: F32, z: F32, n: int) -> None:
    """z[:, :n]: what a sine layer, whose weights begin at `at`, takes the sine of."""
    width, inputs = len(z), len(x)
    bias = at + width * inputs
    set_product(theta[at:bias].reshape(width, inputs), x, theta[bias : bias + width], omega, z, n)


@inlined
def last_layer(theta: F32, width: int, x: F32, y: F32, n: int) -> None:
    """y[:, :n], (2, TILE): heights from what the last sine layer puts out."""
    at = len(theta) - 2 * width - 2
    bias = at + 2 * width
    set_product(theta[at:bias].reshape(2, width), x, theta[bias:], np.float32(1), y, n)


@inlined
def back_through(W: F32, d: F32, e: F32, n: int) -> None:
    """e[:, :n] = W^T d[:, :n]: a gradient on its way back through a layer."""
    set_product(W.T, d, np.zeros(W.shape[1], np.float32), np.float32(1), e, n)


@inlined
def _filled(x: F32, m: int) -> int:
    """The columns m to n of x are filled up, to a multiple of LANES; what becomes of them is not used. Returns n."""
    n = m + -m % LANES
    for c in range(m, n):
        x[0, c], x[1, c] = x[0, 0], x[1, 0]
    return n


@inlined
def values(theta: F32, width: int, layers: int, omega: np.float32, x: F32, n: int, a: F32, b: F32, y: F32) -> None:
    """y[:, :n], (2, TILE): heights of the first n columns of x, (2, TILE). Overwrites a and b, (width, TILE).

    n is a multiple of LANES, here and below.
    """
    arguments(theta, 0, omega, x, a, n)
    sine_in_place(a, n)
    at = 3 * width
    for _ in range(layers - 1):
        arguments(theta, at, omega, a, b, n)
        sine_in_place(b, n)
        a, b = b, a
        at += width * (width + 1)
    last_layer(theta, width, a, y, n)


@inlined
def forward(theta: F32, width: int, layers: int, omega: np.float32, x: F32, n: int, xs: F32, slopes: F32) -> None:
    """Of the first n columns of x, (2, TILE): fills xs and slopes, (layers, width, TILE), with what every sine layer
    puts out and its cosines."""
    z = np.empty((width, TILE), np.float32)
    arguments(theta, 0, omega, x, z, n)
    sine_and_cosine(z, xs[0], slopes[0], n)
    at = 3 * width
    for k in range(1, layers):
        arguments(theta, at, omega, xs[k - 1], z, n)
        sine_and_cosine(z, xs[k], slopes[k], n)
        at += width * (width + 1)


@inlined
def backward(
    theta: F32, width: int, layers: int, omega: np.float32, x: F32, n: int, xs: F32, slopes: F32, g: F32, grad: F32
) -> None:
    """Add the gradient of sum(g * heights), over the first n columns, to grad, (P,)."""
    at = len(theta) - 2
    for j in range(2):
        total = np.float32(0)
        for t in range(n):
            total += g[j, t]
        grad[at + j] += total
    at -= 2 * width
    add_outer(g, xs[layers - 1], grad[at : at + 2 * width].reshape(2, width), n)
    d, e = np.empty((width, TILE), np.float32), np.empty((width, TILE), np.float32)
    back_through(theta[at : at + 2 * width].reshape(2, width), g, d, n)
    for k in range(layers - 1, -1, -1):
        inputs = 2 if k == 0 else width
        at -= width
        for j in range(width):
            total = np.float32(0)
            for t in range(n):
                d[j, t] *= slopes[k, j, t] * omega
                total += d[j, t]
            grad[at + j] += total
        at -= width * inputs
        add_outer(d, x if k == 0 else xs[k - 1], grad[at : at + width * inputs].reshape(width, inputs), n)
        if k:
            back_through(theta[at : at + width * inputs].reshape(width, inputs), d, e, n)
            d, e = e, d


@compiled
def heights(theta: F32, width: int, layers: int, omega: np.float32, uv: F32) -> F32:
    """(N, 2) near and far height of one network, theta (P,), at uv, (N, 2)."""
    a, b = np.empty((width, TILE), np.float32), np.empty((width, TILE), np.float32)
    x, y = np.empty((2, TILE), np.float32), np.empty((2, TILE), np.float32)
    out = np.empty_like(uv)
    for at in range(0, len(uv), TILE):
        n = min(TILE, len(uv) - at)
        for t in range(n):
            x[0, t], x[1, t] = uv[at + t, 0], uv[at + t, 1]
        values(theta, width, layers, omega, x, _filled(x, n), a, b, y)
        for t in range(n):
            out[at + t, 0], out[at + t, 1] = y[0, t], y[1, t]
    return out


@compiled
def heights_gradient(theta: F32, width: int, layers: int, omega: np.float32, uv: F32, g: F32) -> F32:
    """(P,) gradient of sum(g * heights) in theta, (P,); uv and g are (N, 2)."""
    xs, slopes = np.empty((layers, width, TILE), np.float32), np.empty((layers, width, TILE), np.float32)
    x, d = np.empty((2, TILE), np.float32), np.empty((2, TILE), np.float32)
    grad = np.zeros(len(theta), np.float32)
    for at in range(0, len(uv), TILE):
        n = min(TILE, len(uv) - at)
        for t in range(n):
            x[0, t], x[1, t] = uv[at + t, 0], uv[at + t, 1]
            d[0, t], d[1, t] = g[at + t, 0], g[at + t, 1]
        filled = _filled(x, n)
        d[:, n:filled] = 0
        n = filled
        forward(theta, width, layers, omega, x, n, xs, slopes)
        backward(theta, width, layers, omega, x, n, xs, slopes, d, grad)
    return grad


@compiled
def jacobian(theta: F32, width: int, layers: int, omega: np.float32, uv: F32, side: I64) -> F32:
    """(N, P): gradient of height `side` (0 near, 1 far) at every row of uv, (N, 2), in theta, (P,)."""
    xs, slopes = np.empty((layers, width, TILE), np.float32), np.empty((layers, width, TILE), np.float32)
    x = np.empty((2, TILE), np.float32)
    d, e = np.empty((width, TILE), np.float32), np.empty((width, TILE), np.float32)
    out = np.zeros((len(uv), len(theta)), np.float32)
    for start in range(0, len(uv), TILE):
        n = min(TILE, len(uv) - start)
        rows = out[start : start + n]
        for t in range(n):
            x[0, t], x[1, t] = uv[start + t, 0], uv[start + t, 1]
        filled = _filled(x, n)
        forward(theta, width, layers, omega, x, filled, xs, slopes)
        at = len(theta) - 2 - 2 * width
        for t in range(n):
            s = side[start + t]
            rows[t, len(theta) - 2 + s] = 1
            for j in range(width):
                rows[t, at + s * width + j] = xs[layers - 1, j, t]
                d[j, t] = theta[at + s * width + j]
        for k in range(layers - 1, -1, -1):
            inputs = 2 if k == 0 else width
            before = x if k == 0 else xs[k - 1]
            bias, at = at - width, at - width - width * inputs
            for j in range(width):
                for t in range(n):
                    d[j, t] *= slopes[k, j, t] * omega
            for t in range(n):
                for j in range(width):
                    rows[t, bias + j] = d[j, t]
                    for i in range(inputs):
                        rows[t, at + j * inputs + i] = d[j, t] * before[i, t]
            if k:
                back_through(theta[at : at + width * inputs].reshape(width, inputs), d, e, filled)
                d, e = e, d
    return out


@inlined
def _place(point: F32, box: F32, x: F32, m: int) -> None:
    """Column m of x: where a network is asked about a point (3,) of its frame."""
    for c in range(2):
        x[c, m] = min(max(point[c], box[c, 0]), box[c, 1])


@inlined
def composite_gradient(
    theta: F32,
    shape: Shape,
    boxes: F32,
    surface: OnSurface,
    space: InSpace,
    on: I64,
    off: I64,
    on_scale: np.float32,
    off_scale: np.float32,
    grad: F32,
) -> float:
    """The composite loss of some samples; grad, (K, P), becomes its gradient in theta.

    boxes: (K, 3, 2) domain boxes. on, off: samples of the surface and of space that are looked at; on_scale, off_scale:
    what each of them counts.

    All networks that are near say first what f is, in a pass that keeps nothing; the one that decides about a sample is
    then asked once more, in a pass that can be gone back through.
    """
    widths, counts, layers, omegas = shape
    K, first, total = len(theta), len(on), len(on) + len(off)
    widest = widths.max()
    a, b = np.empty((widest, TILE), np.float32), np.empty((widest, TILE), np.float32)
    x, y = np.empty((2, TILE), np.float32), np.empty((2, TILE), np.float32)
    slack, far = np.empty((K, TILE), np.float32), np.empty((K, TILE), np.bool_)
    column = np.empty(TILE, np.int64)
    # Of every sample: which network answers for it, with which height, and how its cost changes with that.
    active, side, slope = np.empty(total, np.int64), np.empty(total, np.int64), np.zeros(total, np.float32)
    points_on, near_on, seen, cosine = surface
    points_off, near_off, excluded, inside, margin, weight = space
    loss = 0.0
    for half in range(2):
        samples = on if half == 0 else off
        points = points_on if half == 0 else points_off
        near = near_on if half == 0 else near_off
        for at in range(0, len(samples), TILE):
            rows = samples[at : at + TILE]
            n = len(rows)
            for k in range(K):
                m = 0
                for t in range(n):
                    slack[k, t] = FAR
                    if near[rows[t], k]:
                        _place(points[k, rows[t]], boxes[k], x, m)
                        column[m] = t
                        m += 1
                if m == 0:
                    continue
                w = widths[k]
                values(theta[k, : counts[k]], w, layers, omegas[k], x, _filled(x, m), a[:w], b[:w], y)
                for c in range(m):
                    t = column[c]
                    z = points[k, rows[t], 2]
                    above, below = y[1, c] - z, z - y[0, c]
                    far[k, t] = above < below
                    slack[k, t] = min(above, below)
            for t in range(n):
                i, s = rows[t], half * first + at + t
                least, who = FAR, 0
                for k in range(K):
                    if slack[k, t] < least:
                        least, who = slack[k, t], k
                if half == 0:
                    if least >= 0:
                        least = FAR
                        for k in range(K):
                            if seen[i, k] and slack[k, t] < least:
                                least, who = slack[k, t], k
                    slope[s] = cosine[i, who] * on_scale * np.sign(least)
                    loss += slope[s] * least
                elif inside[i]:
                    if margin[i] > least:
                        slope[s] = -weight[i] * off_scale
                        loss += slope[s] * (least - margin[i])
                else:
                    least = FAR
                    for k in range(K):
                        if excluded[i, k] and slack[k, t] < least:
                            least, who = slack[k, t], k
                    if margin[i] > -least:
                        slope[s] = weight[i] * off_scale
                        loss += slope[s] * (least + margin[i])
                active[s], side[s] = who, 1 if far[who, t] else 0

    grad[:] = 0
    g = np.empty((2, TILE), np.float32)
    for k in range(K):
        w, own, of_own = widths[k], theta[k, : counts[k]], grad[k, : counts[k]]
        xs, slopes = np.empty((layers, w, TILE), np.float32), np.empty((layers, w, TILE), np.float32)
        m = 0
        for s in range(total + 1):
            if s < total and active[s] == k and slope[s] != 0:
                _place(points_on[k, on[s]] if s < first else points_off[k, off[s - first]], boxes[k], x, m)
                g[side[s], m] = slope[s] * (2 * side[s] - 1)
                g[1 - side[s], m] = 0
                m += 1
            if m == TILE or (m and s == total):
                n = _filled(x, m)
                g[:, m:n] = 0
                forward(own, w, layers, omegas[k], x, n, xs, slopes)
                backward(own, w, layers, omegas[k], x, n, xs, slopes, g, of_own)
                m = 0
    return loss
