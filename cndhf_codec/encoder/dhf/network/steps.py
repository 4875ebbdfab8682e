"""Steps of the joint fit, compiled: threads that work on the same step and wait for each other.

A step takes about a millisecond. Handing its parts to threads through the interpreter, and waking them, would take a
third of that; here every thread runs through all steps, and looks at what the others have reached.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from ....arrays import F32, F64, I64, Mask
from .kernel import InSpace, OnSurface, Shape, compiled, composite_gradient, inlined
from .soap import State, move_matrix

SHARDS = 4  # pieces of a batch that threads work on; as many on every machine, so that their sum is the same
APART = 16  # places between two threads' counters: not in one line of a cache
ALL_DONE = 2**62  # more than there are meetings
GIVE_WAY = "SwitchToThread" if sys.platform == "win32" else "sched_yield"  # the system's function
PATIENCE = 500  # times that a thread looks at another's counter before it lets other programs have the processor

Counters = I64  # of the meetings that each thread has come to


@contextmanager
def not_waited_for(counters: Counters) -> Iterator[None]:
    """A thread that fails in here lets the others go on."""
    try:
        yield
    except BaseException:
        counters[:] = ALL_DONE
        raise


def _counter(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [place])


@intrinsic
def _seen(typing: Any, counters: Any, place: Any) -> Any:
    """A counter; what its thread wrote before it counted can be read after this."""

    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        return b.load_atomic(_counter(context, b, signature.args[0], *args), "acquire", 8)

    return types.int64(counters, place), generate


@intrinsic
def _show(typing: Any, counters: Any, place: Any, value: Any) -> Any:
    """Set a counter, when all that was written before can be read."""

    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        b.store_atomic(args[2], _counter(context, b, signature.args[0], *args[:2]), "release", 8)
        return context.get_dummy_value()

    return types.void(counters, place, value), generate


@intrinsic
def _give_way(typing: Any) -> Any:
    """Let other programs have the processor."""

    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [])
        return b.call(cgutils.get_or_insert_function(b.module, kind, GIVE_WAY), [])

    return types.int32(), generate


@inlined
def _meet(counters: Counters, me: int, threads: int, meeting: int) -> None:
    """Wait until all threads have come to this meeting."""
    _show(counters, me * APART, meeting)
    for other in range(threads):
        looks = 0
        while _seen(counters, other * APART) < meeting:
            looks += 1
            if looks > PATIENCE:
                _give_way()


@compiled
def take_steps(
    me: int,
    threads: int,
    counters: Counters,
    theta: F32,
    shape: Shape,
    boxes: F32,
    surface: OnSurface,
    space: InSpace,
    on: I64,
    off: I64,
    on_scale: np.float32,
    off_scale: np.float32,
    optimiser: State,
    scales: F32,
    refreshes: Mask,
    held: Mask,
    gradients: F32,
    losses: F64,
    pulled: Mask,
) -> None:
    """What thread `me` of `threads` does of some steps. All of them are called at once, with the same arrays.

    counters: (threads * APART,) zeros. shape to space, on_scale, off_scale: as
    `kernel.composite_gradient` takes them. on, off: (S, B), (S, C), the samples of each of S steps. optimiser: of
    `Soap`; scales, (S, K), and refreshes, (S,): what it plans. With no rows of these weights stay as they are, and so
    do those that are held, (K, P).

    Overwrites gradients, (SHARDS, K, P), and losses, (S, SHARDS): the loss of a step is the sum of its row, and where
    weights stay as they are gradients[0] ends as the gradient. Sets pulled, (K,), for each network with a gradient.
    """
    places = optimiser[0]
    K, M = places.shape[:2]
    n_on, n_off = on.shape[1], off.shape[1]
    for s in range(len(on)):
        for shard in range(me, SHARDS, threads):
            losses[s, shard] = composite_gradient(
                theta,
                shape,
                boxes,
                surface,
                space,
                on[s, n_on * shard // SHARDS : n_on * (shard + 1) // SHARDS],
                off[s, n_off * shard // SHARDS : n_off * (shard + 1) // SHARDS],
                on_scale,
                off_scale,
                gradients[shard],
            )
        _meet(counters, me, threads, 2 * s + 1)
        for task in range(me, K * M, threads):
            k, m = task // M, task % M
            at, rows, columns = places[k, m]
            for i in range(at, at + rows * (columns + 1)):
                total = gradients[0, k, i]
                for shard in range(1, SHARDS):
                    total += gradients[shard, k, i]
                if total != 0:  # threads only ever set it
                    pulled[k] = True
                gradients[0, k, i] = 0 if held[k, i] else total
            if len(scales):
                move_matrix(theta, gradients[0], held, k, m, optimiser, scales[s, k], refreshes[s])
        _meet(counters, me, threads, 2 * s + 2)
