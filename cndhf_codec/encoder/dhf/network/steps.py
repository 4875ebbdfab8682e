"""Compiled steps of the joint fit: threads work on the same step and wait for each other.

A step takes about a millisecond. Handing its parts to threads through the interpreter, and waking them, would take a
third of that. Here every thread runs through all steps, and watches counters that say how far the others are.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from ....arrays import F32, F64, I64, Mask
from .kernel import Batch, LossData, compiled, inlined, joint_gradient
from .soap import State, soap_update

# Evidence for these constants: ADR 021.
SHARDS = 4  # pieces of a batch that threads work on; equally many on every machine, so that the sums are the same
APART = 16  # distance between two threads' counters: they must not share a line of the cache
ALL_DONE = 2**62  # more than any number of meetings
GIVE_WAY = "SwitchToThread" if sys.platform == "win32" else "sched_yield"  # the system's function
PATIENCE = 500  # times that a thread reads another's counter before it gives way to other programs

Counters = I64  # number of the meeting that each thread has reached


class Batches(NamedTuple):
    """Samples of S steps. surface: (S, B) and space: (S, C) rows. surface_scale, space_scale: as in `Batch`."""

    surface: I64
    space: I64
    surface_scale: np.float32
    space_scale: np.float32

    def part(self, first: int, last: int) -> Batches:
        """Steps from `first` to `last` - 1."""
        return self._replace(surface=self.surface[first:last], space=self.space[first:last])


class StepPlan(NamedTuple):
    """How weights change in S steps. scales: (S, K) and refreshes: (S,), from `Soap.plan`. held: (K, P) weights that
    stay as they are."""

    scales: F32
    refreshes: Mask
    held: Mask


class Output(NamedTuple):
    """Arrays that steps write to. gradients: (SHARDS, K, P). losses: (S, SHARDS), the loss of a step is the sum of its
    row. pulled: (K,) set to true for each network with a gradient."""

    gradients: F32
    losses: F64
    pulled: Mask


@contextmanager
def not_waited_for(counters: Counters) -> Iterator[None]:
    """Let the other threads go on when this one fails in here."""
    try:
        yield
    except BaseException:
        counters[:] = ALL_DONE
        raise


def _counter(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [place])


@intrinsic
def _read_counter(typing: Any, counters: Any, place: Any) -> Any:
    """Read a counter. Everything that its thread wrote before setting it can be read after this."""

    def generate(context: Any, b: Any, signature: Any, args: Any) -> Any:
        return b.load_atomic(_counter(context, b, signature.args[0], *args), "acquire", 8)

    return types.int64(counters, place), generate


@intrinsic
def _set_counter(typing: Any, counters: Any, place: Any, value: Any) -> Any:
    """Set a counter, after making everything written before readable."""

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
    """Wait until all threads have reached this meeting."""
    _set_counter(counters, me * APART, meeting)
    for other in range(threads):
        looks = 0
        while _read_counter(counters, other * APART) < meeting:
            looks += 1
            if looks > PATIENCE:
                _give_way()


@compiled
def take_steps(
    me: int,
    counters: Counters,
    theta: F32,
    loss: LossData,
    batches: Batches,
    optimiser: State,
    plan: StepPlan,
    out: Output,
) -> None:
    """Do the share of thread `me` of some steps. All threads call this at once, with the same arrays.

    counters: (threads * APART,) zeros. Where the plan has no scales, the weights stay as they are, and out.gradients[0]
    ends as the gradient.
    """
    threads = len(counters) // APART
    K, M = optimiser.places.shape[:2]
    n_surface, n_space = batches.surface.shape[1], batches.space.shape[1]
    for s in range(len(batches.surface)):
        for shard in range(me, SHARDS, threads):
            surface = batches.surface[s, n_surface * shard // SHARDS : n_surface * (shard + 1) // SHARDS]
            space = batches.space[s, n_space * shard // SHARDS : n_space * (shard + 1) // SHARDS]
            batch = Batch(surface, space, batches.surface_scale, batches.space_scale)
            out.losses[s, shard] = joint_gradient(theta, loss, batch, out.gradients[shard])
        _meet(counters, me, threads, 2 * s + 1)
        for task in range(me, K * M, threads):
            k, m = task // M, task % M
            at, rows, columns = optimiser.places[k, m]
            for i in range(at, at + rows * (columns + 1)):
                total = out.gradients[0, k, i]
                for shard in range(1, SHARDS):
                    total += out.gradients[shard, k, i]
                if total != 0:  # threads only ever set it
                    out.pulled[k] = True
                out.gradients[0, k, i] = 0 if plan.held[k, i] else total
            if len(plan.scales):
                soap_update(theta, out.gradients[0], plan.held, k, m, optimiser, plan.scales[s, k], plan.refreshes[s])
        _meet(counters, me, threads, 2 * s + 2)
