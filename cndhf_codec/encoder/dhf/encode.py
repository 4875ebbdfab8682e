"""Encode a solid as double height fields, fitted and rounded together, to a given size."""

from __future__ import annotations

import math
import time

import numpy as np

from ...format.container import parameter_count
from ...mesh.solid import Solid
from ..deadline import Deadline
from ..encoded import Encoded
from ..progress import Stage
from ..thread_pool import ThreadPool
from .axes.trials import make_plan
from .fit.fields import fit_needed
from .fit.single import one_torch_thread
from .job import Job, Plan
from .rounding.gauss_newton import BLOCK_COLUMNS
from .rounding.to_size import round_to_size
from .settings import DhfSettings

# Share of a time limit for trials, and the most and the least share of what is left for the fit.
PLAN_SHARE, FIT_SHARE, LEAST_FIT_SHARE = 0.15, 0.65, 0.2
# Rounding takes about so many times as long as the products of its first matrices, beside the training in it.
ROUNDING_FACTOR = 3.0
ROWS = 2048  # of the product that is timed


def encode_dhf(
    solid: Solid,
    settings: DhfSettings,
    other_bytes: int,
    seed: int,
    threads: int,
    stage: Stage,
    deadline: Deadline,
) -> Encoded:
    """Encode a solid. other_bytes: of the file, besides the body of its shape."""
    with one_torch_thread(), ThreadPool(threads) as pool:
        job = Job(solid, settings.within(deadline.left()).for_size(), other_bytes, seed, pool, stage)
        plan = make_plan(job, deadline.part(PLAN_SHARE))
        if plan.visible == 0:
            return Encoded([], 0.0, 0.0, 0.0)
        plan, networks, loss, unknown = fit_needed(job, plan, deadline.part(_fit_share(job, plan, deadline)))
        records = round_to_size(job, plan, networks, loss, deadline)
    return Encoded(records, plan.covered, plan.visible, unknown)


def _fit_share(job: Job, plan: Plan, deadline: Deadline) -> float:
    """Share of the time left for the fit: rounding takes time that no deadline makes shorter, which is reserved."""
    left = deadline.left()
    if not 0 < left < math.inf:
        return FIT_SHARE
    counts = [parameter_count(width, job.settings.hidden_layers) for width in plan.widths]
    seconds = 0.0
    for count in counts:
        matrix = np.ones((ROWS, count), dtype=np.float32)
        start = time.perf_counter()
        matrix[:, :BLOCK_COLUMNS].T @ matrix[:, :BLOCK_COLUMNS]
        blocks = (count / BLOCK_COLUMNS) ** 2 / 2
        seconds += (time.perf_counter() - start) * blocks * job.settings.samples_per_weight * 1.5 * count / ROWS
    reserved = ROUNDING_FACTOR * seconds / job.threads.threads
    return min(max((left - reserved) / left, LEAST_FIT_SHARE), FIT_SHARE)
