"""Choose the set of axes, and how many there are, by trials: short fits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ....decoder.model import Model
from ....errors import CndhfError, OptionError
from ....format import Container
from ....mesh.distances import surface_distances
from ...deadline import Deadline
from ...progress import Stage
from ...thread_pool import ThreadPool
from ..fit.fields import SINGLE_SHARE, fit_jointly, fit_singly
from ..fit.joint import IdleNetworkError
from ..job import Job, Plan, with_shares
from ..network.siren import Networks
from ..records import finest_codes, records_of
from ..widths import WIDEST_EQUAL, widths_for
from .costs import AxisCosts
from .mirrors import frame_with_mirrors, mirror_planes

# Evidence for these constants: ADR 005.
TRIAL_SAMPLES, TRIAL_CLEAR_CELLS, TRIAL_TARGET_RESOLUTION = 100_000, 24, 256  # settings of a trial
TRIAL_SURFACE_RESOLUTION, TRIAL_MEASURED_POINTS = 96, 20_000  # of the surface that a trial's error is measured with
SHRINK = 0.36  # share that the whole fit leaves of a trial's error above the error lower bound
SHRINK_PER_AXIS = 0.94  # times that share per axis above two: narrow networks have more to learn after a trial
# The best few sets, with errors of less than FINALIST_RATIO times the least, are tried again, LONGER times as long.
FINALISTS, FINALIST_RATIO, LONGER, LONGER_SHRINK = 3, 1.5, 4, 0.5
ABREAST = 2  # trials at a time, if there are threads for them: outside its steps a trial uses one thread


@dataclass(frozen=True, eq=False)
class Trial:
    """The result of a short fit.

    error: mean error (normalised units); infinite where the solid is empty or a field is idle. shares: share of the
    loss that each field answers for. start: the networks after their single fits.
    """

    error: float
    shares: list[float]
    start: Networks | None


@dataclass(frozen=True)
class TrialRound:
    """How plans are compared.

    steps: joint steps of each trial. shrink: share that the whole fit leaves of their errors (as SHRINK). reserve:
    number of later trials of this length for which the deadline must leave time.
    """

    steps: int
    shrink: float
    reserve: int


def make_plan(job: Job, deadline: Deadline) -> Plan:
    """Choose the axes by trials at the size asked for; the widths follow from their number."""
    settings = job.settings
    options = _options(job)
    if not options:
        raise OptionError(f"a target size of {settings.target_size} bytes is too small for one double height field")
    if len(options) == 1 or settings.trial_steps == 0:
        return options[-1]
    # Most axes first: a set of fewer needs no trial where its error lower bound is above their errors.
    options.reverse()
    report = job.stage("plan", len(options) + FINALISTS)
    first = TrialRound(settings.trial_steps, SHRINK, FINALISTS * LONGER)
    errors, trials = _compare(job, options, [None] * len(options), first, deadline, report)
    order = np.argsort(errors, kind="stable")[:FINALISTS]
    close = [k for k in order if errors[k] < FINALIST_RATIO * errors[order[0]]] or [order[0]]
    finalists = [options[k] for k in close]
    if len(finalists) == 1 and (settings.width is not None or max(finalists[0].widths) < WIDEST_EQUAL):
        return finalists[0]  # a trial could change nothing

    def report_later(done: int, error: float) -> None:
        report(len(options) + done, error)

    final = TrialRound(settings.trial_steps * LONGER, LONGER_SHRINK, 0)
    errors, trials = _compare(job, finalists, [trials[k].start for k in close], final, deadline, report_later)
    best = int(np.argmin(errors))
    return with_shares(finalists[best], trials[best].shares, job)


def _options(job: Job) -> list[Plan]:
    """Propose plans of one axis, of two, and so on."""
    settings = job.settings
    job.stage("axes", 1)
    planes = mirror_planes(job.solid, job.seed)
    costs = AxisCosts(job.solid, job.seed, job.threads, planes)
    most = 1 if costs.visible == 0 else settings.max_axes
    options: list[Plan] = []
    for count in range(1, most + 1):
        if not widths_for(settings, [1.0] * count, job.other_bytes):
            break
        for chosen in costs.sets(count):
            frames = [frame_with_mirrors(costs.axes[i], job.solid.vertices, planes) for i in chosen]
            bound = costs.error_lower_bound(chosen)
            if any(f.fold for f in frames):
                bound += max(p.error for p in planes) / 2
            shares = costs.shares(chosen).tolist()
            widths = widths_for(settings, shares, job.other_bytes)
            options.append(Plan(frames, shares, widths, bound, costs.covered(chosen), costs.visible))
    return options


def _compare(
    job: Job,
    plans: list[Plan],
    starts: list[Networks | None],
    of: TrialRound,
    deadline: Deadline,
    report: Callable[[int, float], None],
) -> tuple[list[float], list[Trial]]:
    """Try all plans, ABREAST at a time; return their predicted errors and their trials. A plan whose error lower bound
    is not below the predicted error of an earlier one is not tried, and has an infinite error."""
    errors: list[float] = []
    trials: list[Trial] = []
    abreast = min(ABREAST, job.threads.threads)
    for first in range(0, len(plans), abreast):
        some = range(first, min(first + abreast, len(plans)))
        running = [k for k in some if plans[k].error_lower_bound < min(errors, default=math.inf)]
        part = deadline.part(len(running) / (len(plans) - first + of.reserve))

        def run(k: int, running: list[int] = running, part: Deadline = part) -> Trial:
            if k not in running:
                return Trial(math.inf, plans[k].shares, None)
            with ThreadPool(job.threads.threads // len(running)) as threads:
                return _trial(replace(job, threads=threads), plans[k], of.steps, part, starts[k])

        trials += job.threads.map(run, some)
        for k in some:
            # Spare the same plans with any number of threads.
            spared = plans[k].error_lower_bound >= min(errors, default=math.inf)
            errors.append(math.inf if spared else predicted_error(plans[k], trials[k].error, of.shrink))
        report(len(errors), min(errors))
    return errors, trials


def predicted_error(plan: Plan, trial: float, shrink: float) -> float:
    """Predict the error of a whole fit from a trial's: the error lower bound stays, and a share of the rest."""
    bound = plan.error_lower_bound
    return bound + shrink * SHRINK_PER_AXIS ** (len(plan.frames) - 2) * (trial - bound)


def _trial(job: Job, plan: Plan, steps: int, deadline: Deadline, start: Networks | None) -> Trial:
    """Try a plan. start: the networks that an earlier trial of it began with, if there was one."""
    short = replace(
        job.settings,
        steps=job.settings.trial_steps // 3,
        joint_steps=steps,
        samples=TRIAL_SAMPLES,
        clear_cells=TRIAL_CLEAR_CELLS,
        target_resolution=TRIAL_TARGET_RESOLUTION,
    )
    silent: Stage = lambda name, total: lambda done, loss: None  # noqa: E731
    job = replace(job, settings=short, stage=silent)
    if start is None:
        start, _ = fit_singly(job, plan, deadline.part(SINGLE_SHARE))
    failed = Trial(math.inf, plan.shares, start)
    try:
        networks, loss = fit_jointly(job, plan, start, deadline)
    except IdleNetworkError:
        return failed
    records = records_of(networks, finest_codes(networks), plan.frames)
    try:
        surface = Model(Container((0.0, 0.0, 0.0), 1.0, tuple(records))).surface(TRIAL_SURFACE_RESOLUTION)
    except CndhfError:
        return failed
    truth = job.solid.vertices, job.solid.faces
    distances = surface_distances(*truth, *surface, job.seed, TRIAL_MEASURED_POINTS)
    return Trial(distances.mean, loss.shares(networks), start)
