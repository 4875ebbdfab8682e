"""Fit the fields of a plan: each alone, then all together."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ...deadline import Deadline
from ..job import Job, Plan, with_shares
from ..network.siren import Networks, stacked
from ..widths import omega_for
from .clear_space import ClearSpace
from .joint import FULL_RATE_WIDTH, IdleNetworkError, Schedule, joint_fit
from .loss import JointLoss
from .samples import draw_samples
from .single import Training, fit_each, fit_single
from .targets import height_targets

SINGLE_SHARE = 0.15  # of a time limit goes to the single fits


def fit_needed(job: Job, plan: Plan, deadline: Deadline) -> tuple[Plan, Networks, JointLoss, float]:
    """Fit the fields of a plan. Where one turns out to be idle, fit again without it, with the others wider.

    Returns the plan that was fitted, the networks, the loss with its samples, and the share of rays through holes.
    """
    while True:
        part = deadline.part(1)
        try:
            start, unknown = fit_singly(job, plan, part.part(SINGLE_SHARE))
            return plan, *fit_jointly(job, plan, start, part), unknown
        except IdleNetworkError as idle:
            # Nothing limits the steps of an idle network, so it cannot be rounded.
            frames = [f for k, f in enumerate(plan.frames) if k != idle.number]
            shares = [s for k, s in enumerate(plan.shares) if k != idle.number]
            plan = with_shares(replace(plan, frames=frames), shares, job)


def fit_singly(job: Job, plan: Plan, deadline: Deadline) -> tuple[Networks, float]:
    """Fit each network alone. Returns also the share of rays through holes."""
    settings = job.settings
    trainings = [
        Training(
            width=width,
            hidden_layers=settings.hidden_layers,
            omega=omega_for(settings, width),
            steps=settings.steps,
            learning_rate=settings.learning_rate * min(1.0, FULL_RATE_WIDTH / width),  # else wide ones get steep
            batch=settings.batch,
            margin=settings.margin,
        )
        for width in plan.widths
    ]
    targets = job.threads.map(lambda f: height_targets(job.solid, f, settings.target_resolution), plan.frames)
    fits = [
        partial(fit_single, of_field, training, job.seed + k, deadline)
        for k, (of_field, training) in enumerate(zip(targets, trainings, strict=True))
    ]
    on_step = job.stage("fit", settings.steps * len(targets))
    return stacked(fit_each(fits, job.threads, on_step)), max(t.unknown for t in targets)


def fit_jointly(job: Job, plan: Plan, start: Networks, deadline: Deadline) -> tuple[Networks, JointLoss]:
    """Fit the networks together from a start. Returns also the loss with its samples. Raises IdleNetworkError when the
    others do without one of them."""
    settings, networks = job.settings, start.copy()
    samples = draw_samples(job.solid, plan.frames, settings.samples, job.seed)
    clear = ClearSpace(job.solid, plan.frames, samples.sides, settings.clear_cells)
    loss = JointLoss(samples, clear, plan.frames, job.threads)
    report = job.stage("joint fit", settings.joint_steps)
    schedule = Schedule(settings.batch, settings.joint_steps, settings.joint_rate)
    joint_fit(networks, loss, schedule, job.seed, report, deadline)
    return networks, loss
