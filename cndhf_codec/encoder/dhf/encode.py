"""Encode a solid as double height fields, fitted and rounded together, to a given size."""

from __future__ import annotations

from ...mesh.solid import Solid
from ..deadline import Deadline
from ..encoded import Encoded
from ..progress import Stage
from ..thread_pool import ThreadPool
from .axes.trials import make_plan
from .fit.fields import fit_needed
from .fit.single import one_torch_thread
from .job import Job
from .rounding.to_size import round_to_size
from .settings import DhfSettings

# Share of a time limit for trials, and share of what is left for the fit.
PLAN_SHARE, FIT_SHARE = 0.15, 0.65


def encode_dhf(
    solid: Solid,
    settings: DhfSettings,
    metadata_bytes: int,
    seed: int,
    threads: int,
    stage: Stage,
    deadline: Deadline,
) -> Encoded:
    """Encode a solid. metadata_bytes: size of the metadata section with its row in the section table."""
    with one_torch_thread(), ThreadPool(threads) as pool:
        job = Job(solid, settings.for_size(), metadata_bytes, seed, pool, stage)
        plan = make_plan(job, deadline.part(PLAN_SHARE))
        if plan.visible == 0:
            return Encoded([], 0.0, 0.0, 0.0)
        plan, networks, loss, unknown = fit_needed(job, plan, deadline.part(FIT_SHARE))
        records = round_to_size(job, plan, networks, loss, deadline)
    return Encoded(records, plan.covered, plan.visible, unknown)
