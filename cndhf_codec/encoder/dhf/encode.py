"""Our method: all double height fields are fitted and rounded together, to a given size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from ...arrays import F64
from ...decoder.model import Model
from ...errors import CndhfError, EncodeError, OptionError
from ...format import Container, DhfRecord, rans
from ...format.constants import MAX_WIDTH, STEPS_PER_OCTAVE
from ...format.container import Symbols, parameter_count
from ...mesh.distances import surface_distances
from ...mesh.solid import Solid
from ..deadline import Deadline
from ..progress import OnStep, Stage
from ..settings import Settings
from ..thread_pool import Team
from .axes.costs import AxisCosts
from .axes.mirrors import frame_with_mirrors, mirror_planes
from .fit.joint import STEADY, IdleNetworkError, tune
from .fit.loss import Composite
from .fit.samples import FarSpace, draw_samples
from .fit.single import fit_all, one_torch_thread
from .frames import Frame, height_targets
from .network.siren import Networks, stacked
from .rounding.feedback import Codes, relative_steps, round_networks, sensitivities, step_codes, weight_steps
from .rounding.symmetries import fold_biases, sort_neurons

FILE_BYTES = 40 + 2 * 6 + 4 + 4  # header, section table, checksum and coder state of a file without metadata
DHF_BYTES = 40 + 14  # record and scale codes of a DHF of five hidden layers
LEAST_WIDTH = 5
# Widest that all networks are equally; how the weights of wider ones grow with their shares; the least of these.
OUTLINE, BALANCE, LEAST_SHARE = 25, 0.5, 1e-3
WIDE, MOST_OMEGA = 24, 1.5  # beyond this width omega grows with the width, to at most 1.5 times the preset's
AIM = 0.98  # of the size asked for is what the rounding aims at: the size is known only afterwards
WITHIN = 0.95  # of the size asked for is the least that is good enough
ATTEMPTS = 3
MADE = 2.0  # times as many points in floaters and slits as before rounding: rounding has made some
BITS_RANGE = (3.0, 12.0)
TRIAL_SAMPLES, TRIAL_CELLS, TRIAL_RESOLUTION, TRIAL_POINTS = 100_000, 24, 96, 20_000
# Of a time limit: trial fits; of what is left then the fit, and of that the fit of every DHF alone; of what is left
# then the first attempt at rounding.
PLAN_SHARE, FIT_SHARE, ALONE_SHARE, FIRST_SHARE = 0.15, 0.65, 0.15, 0.7
SHRINK = 0.36  # what the whole fit leaves of a trial's error, less that of the exact height fields
NARROWER = 0.94  # times as much of it for every axis above two: narrow networks have more to learn after a trial
# The best few are tried again, for longer, where they are about as good.
FINALISTS, CLOSE, LONGER, LONGER_SHRINK = 3, 1.5, 4, 0.5
ABREAST = 2  # trials at a time, where there are threads for them: what each does outside its steps takes one thread


@dataclass(frozen=True, eq=False)
class Job:
    """What all stages need to know. metadata_bytes: size of the metadata section with its row in the table."""

    solid: Solid
    settings: Settings
    metadata_bytes: int
    seed: int
    device: torch.device
    team: Team
    stage: Stage


def encode_joint(
    solid: Solid,
    settings: Settings,
    metadata_bytes: int,
    seed: int,
    device: torch.device,
    threads: int,
    stage: Stage,
    deadline: Deadline,
) -> tuple[list[DhfRecord], float, float, float]:
    """DHF records, and the shares of surface that the chosen and that any axes see, and of rays through holes."""
    with one_torch_thread(), Team(threads) as team:
        job = Job(solid, settings.for_size(), metadata_bytes, seed, device, team, stage)
        plan = make_plan(job, deadline.part(PLAN_SHARE))
        if plan.visible == 0:
            return [], 0.0, 0.0, 0.0
        plan, networks, composite, unknown = fit_needed(job, plan, deadline.part(FIT_SHARE))
        records = round_to_size(job, plan, networks, composite, deadline)
    return records, plan.covered, plan.visible, unknown


@dataclass(frozen=True, eq=False)
class Plan:
    """Axes (as frames) and widths of their networks; covered and visible are shares of the input's surface.

    shares: of the surface for which each axis is the best of them, or, after a trial, of the loss that it answers for.
    floor: about the Chamfer distance of the exact height fields (normalised units).
    """

    frames: list[Frame]
    shares: list[float]
    widths: list[int]
    floor: float
    covered: float
    visible: float


def make_plan(job: Job, deadline: Deadline) -> Plan:
    """Choose the axes by short trial fits at the size asked for; the width follows from their number."""
    settings = job.settings
    job.stage("axes", 1)
    planes = mirror_planes(job.solid, job.seed)
    costs = AxisCosts(job.solid, job.seed, job.team, planes)
    most = 1 if costs.visible == 0 else settings.max_axes or 1
    options: list[Plan] = []
    for count in range(1, most + 1):
        if not widths_for(settings, [1.0] * count, job.metadata_bytes):
            break
        for chosen in costs.sets(count):
            frames = [frame_with_mirrors(costs.axes[i], job.solid.vertices, planes) for i in chosen]
            floor = costs.floor(chosen) + (max(p.error for p in planes) / 2 if any(f.fold for f in frames) else 0)
            shares = costs.shares(chosen).tolist()
            widths = widths_for(settings, shares, job.metadata_bytes)
            options.append(Plan(frames, shares, widths, floor, costs.covered(chosen), costs.visible))
    if not options:
        raise OptionError(f"a target size of {settings.target_size} bytes is too small for one double height field")
    if len(options) == 1 or settings.trial_steps == 0:
        return options[-1]
    # Most axes first: their errors then often spare a trial with fewer, whose exact height fields leave more than that.
    options.reverse()
    report = job.stage("plan", len(options) + FINALISTS)
    starts: list[Networks | None] = [None] * len(options)
    reserve = FINALISTS * LONGER
    errors, trials = _compare(job, options, starts, settings.trial_steps, SHRINK, deadline, reserve, report)
    order = np.argsort(errors, kind="stable")[:FINALISTS]
    close = [k for k in order if errors[k] < CLOSE * errors[order[0]]] or [order[0]]
    finalists = [options[k] for k in close]
    if len(finalists) == 1 and (settings.width is not None or max(finalists[0].widths) < OUTLINE):
        return finalists[0]  # a trial could change nothing

    def report_later(done: int, error: float) -> None:
        report(len(options) + done, error)

    starts = [trials[k].start for k in close]
    steps = settings.trial_steps * LONGER
    errors, trials = _compare(job, finalists, starts, steps, LONGER_SHRINK, deadline, 0, report_later)
    best = int(np.argmin(errors))
    return with_shares(finalists[best], trials[best].shares, job)


def _compare(
    job: Job,
    plans: list[Plan],
    starts: list[Networks | None],
    steps: int,
    shrink: float,
    deadline: Deadline,
    reserve: int,
    report: OnStep,
) -> tuple[list[float], list[Trial]]:
    """Predicted error of every plan, and its trial of so many steps, ABREAST side by side. A plan whose exact height
    fields leave more than a plan before it is spared, and has an infinite error. reserve: as many trials more the
    deadline shall have time for."""
    errors: list[float] = []
    trials: list[Trial] = []
    abreast = min(ABREAST, job.team.threads)
    for first in range(0, len(plans), abreast):
        some = range(first, min(first + abreast, len(plans)))
        running = [k for k in some if plans[k].floor < min(errors, default=math.inf)]
        part = deadline.part(len(running) / (len(plans) - first + reserve))

        def run(k: int, running: list[int] = running, part: Deadline = part) -> Trial:
            if k not in running:
                return Trial(math.inf, plans[k].shares, None)
            with Team(job.team.threads // len(running)) as team:
                return _trial(replace(job, team=team), plans[k], steps, part, starts[k])

        trials += job.team.map(run, some)
        for k in some:
            # Threads do not change who is spared.
            spared = plans[k].floor >= min(errors, default=math.inf)
            errors.append(math.inf if spared else _predicted(plans[k], trials[k].error, shrink))
        report(len(errors), min(errors))
    return errors, trials


def with_shares(plan: Plan, shares: list[float], job: Job) -> Plan:
    """The plan with other shares, and the widths that follow."""
    return replace(plan, shares=shares, widths=widths_for(job.settings, shares, job.metadata_bytes))


def _predicted(plan: Plan, trial: float, shrink: float) -> float:
    """Error of a whole fit, from a trial's: what the exact height fields leave stays, and a share of the rest."""
    return plan.floor + shrink * NARROWER ** (len(plan.frames) - 2) * (trial - plan.floor)


def widths_for(settings: Settings, shares: list[float], metadata_bytes: int) -> list[int]:
    """The width asked for, or those at which networks, one a share (as `Plan.shares`), fill the target size at the
    preset's bits a weight; none where there is no room.

    If the error of a field whose share of it is s falls with its number of weights n as s (s / n)^a, then n in
    proportion to s leaves the least; but a field of a small share has its whole outline to learn, too: n grows as
    s^BALANCE, and while none is wider than OUTLINE all are equally wide.
    """
    if settings.width is not None:
        return [settings.width] * len(shares)
    assert settings.target_size is not None
    room = settings.target_size * AIM - FILE_BYTES - metadata_bytes - len(shares) * DHF_BYTES
    parameters = room * 8 / settings.bits
    size = partial(parameter_count, hidden_layers=settings.hidden_layers)
    width = 0
    while width < OUTLINE and len(shares) * size(width + 1) <= parameters:
        width += 1
    if width < LEAST_WIDTH:
        return []
    widths = [width] * len(shares)
    if width < OUTLINE:
        return widths
    needs = np.maximum(shares, LEAST_SHARE) ** BALANCE
    while True:
        left = parameters - sum(map(size, widths))
        wider = [k for k, w in enumerate(widths) if w < MAX_WIDTH and size(w + 1) - size(w) <= left]
        if not wider:
            return widths
        widths[min(wider, key=lambda k: size(widths[k] + 1) / needs[k])] += 1


def omega_for(settings: Settings, width: int) -> int:
    """Networks of more weights can follow finer detail, but learn it only where omega lets them."""
    return round(settings.omega * min(max(width / WIDE, 1.0), MOST_OMEGA))


def fit_needed(job: Job, plan: Plan, deadline: Deadline) -> tuple[Plan, Networks, Composite, float]:
    """As `fit_plan`, once more without a DHF that turns out to be idle, the others being as much wider. Returns the
    plan that was fitted, too."""
    while True:
        try:
            return plan, *fit_plan(job, plan, deadline.part(1))
        except IdleNetworkError as idle:
            # Rounding would take an idle network for one that may be rounded as coarsely as one likes.
            frames = [f for k, f in enumerate(plan.frames) if k != idle.number]
            shares = [s for k, s in enumerate(plan.shares) if k != idle.number]
            plan = with_shares(replace(plan, frames=frames), shares, job)


def fit_plan(job: Job, plan: Plan, deadline: Deadline) -> tuple[Networks, Composite, float]:
    """Fit every DHF alone, then all together. Returns networks, samples, and the share of rays through holes. Raises
    IdleNetworkError when the others do without one of them."""
    start, unknown = fit_alone(job, plan, deadline.part(ALONE_SHARE))
    return *fit_together(job, plan, start, deadline), unknown


def fit_alone(job: Job, plan: Plan, deadline: Deadline) -> tuple[Networks, float]:
    """Networks that are each fitted alone, and the share of rays through holes."""
    settings = job.settings
    of_each = [
        replace(
            settings,
            width=w,
            omega=omega_for(settings, w),
            learning_rate=settings.learning_rate * min(1.0, STEADY / w),  # wide ones have come out steep
        )
        for w in plan.widths
    ]
    targets = job.team.map(lambda f: height_targets(job.solid, f, settings.target_resolution), plan.frames)
    report_all = job.stage("fit", settings.steps * len(targets))

    def on_steps(done: int, total: int, loss: float) -> None:
        report_all(done, loss)

    networks = stacked(fit_all(targets, of_each, job.seed, job.device, job.team, on_steps, deadline))
    networks = replace(networks, theta=networks.theta.to(job.device))
    return networks, max(t.unknown for t in targets)


def fit_together(job: Job, plan: Plan, start: Networks, deadline: Deadline) -> tuple[Networks, Composite]:
    """Networks tuned together from that start, and the samples that they were tuned on. Raises IdleNetworkError."""
    settings, networks = job.settings, start.copy()
    samples = draw_samples(job.solid, plan.frames, settings.samples, job.seed)
    far = FarSpace(job.solid, plan.frames, samples.sides, settings.far_cells)
    composite = Composite(samples, far, plan.frames, job.device, job.team)
    report = job.stage("tune", settings.tune_steps)
    tune(networks, composite, settings.batch, settings.tune_steps, settings.tune_rate, job.seed, report, deadline)
    return networks, composite


def round_to_size(
    job: Job, plan: Plan, networks: Networks, composite: Composite, deadline: Deadline
) -> list[DhfRecord]:
    """Round the networks, so that the file has the size asked for. Raises EncodeError when it cannot be met."""
    settings, seed, team = job.settings, job.seed, job.team
    fixed = FILE_BYTES + job.metadata_bytes + 40 * len(networks)
    room = None if settings.target_size is None else settings.target_size - fixed
    aim = 0.0 if room is None else room * AIM
    networks = fold_biases(networks)
    best: list[DhfRecord] | None = None
    fewest: float = math.inf
    allowed = MADE * composite.strays(networks)
    matrices = sensitivities(networks, composite, seed, team)
    logs = relative_steps(networks, matrices)
    for attempt in range(ATTEMPTS):
        bits = settings.bits if room is None else _bits_for(networks, logs, aim)
        codes = step_codes(networks, logs, bits)
        report = job.stage("round", max(settings.rounds - 1, 1) * settings.round_steps)
        rounded = networks.copy()
        time_left = deadline.part(1 if attempt else FIRST_SHARE)
        round_networks(rounded, composite, settings, codes, matrices, seed + attempt, team, report, time_left)
        records = _records(rounded, codes, plan.frames)
        size = _coded_size(records)
        strays = composite.strays(rounded)
        if (room is None or size <= room) and strays < fewest:
            fewest, best = strays, records
        # A floater or a slit that rounding has made goes away with other samples, as a rule; one that was there stays.
        enough = room is None or WITHIN * (room + fixed) <= size + fixed <= room + fixed
        if enough and (strays <= allowed or attempt > 0):
            break
        if best is not None and deadline.passed() > 1 - FIRST_SHARE / 2:
            break  # another attempt would be over time
        if room is not None and not WITHIN * room <= size <= room:
            aim *= AIM * room / size
    if best is None:
        raise EncodeError(f"no file of {settings.target_size} bytes or less was reached; ask for a larger size")
    return best


@dataclass(frozen=True, eq=False)
class Trial:
    """error: Chamfer distance (normalised) after a short fit; infinite when it leaves nothing, or a DHF has nothing to
    do. shares: of the loss, which each DHF answers for then. start: the networks fitted alone."""

    error: float
    shares: list[float]
    start: Networks | None


def _trial(job: Job, plan: Plan, steps: int, deadline: Deadline, start: Networks | None) -> Trial:
    """start: what an earlier trial of the plan began with."""
    short = replace(
        job.settings,
        steps=job.settings.trial_steps // 3,
        tune_steps=steps,
        samples=TRIAL_SAMPLES,
        far_cells=TRIAL_CELLS,
        target_resolution=256,
    )
    silent: Stage = lambda name, total: lambda done, loss: None  # noqa: E731
    job = replace(job, settings=short, stage=silent)
    if start is None:
        start, _ = fit_alone(job, plan, deadline.part(ALONE_SHARE))
    failed = Trial(math.inf, plan.shares, start)
    try:
        networks, composite = fit_together(job, plan, start, deadline)
    except IdleNetworkError:
        return failed
    records = _records(networks, _finest(networks), plan.frames)
    try:
        surface = Model(Container((0.0, 0.0, 0.0), 1.0, tuple(records))).surface(TRIAL_RESOLUTION)
    except CndhfError:
        return failed
    truth = job.solid.vertices, job.solid.faces
    distances = surface_distances(*truth, *surface, job.seed, TRIAL_POINTS)
    return Trial(distances.chamfer, composite.shares(networks), start)


def _bits_for(networks: Networks, logs: F64, size: float) -> float:
    """Bits a weight at which the plainly rounded networks take `size` bytes."""
    low, high = BITS_RANGE
    for _ in range(12):
        bits = (low + high) / 2
        symbols = [s for part in _symbols(networks, step_codes(networks, logs, bits)) for s in part]
        low, high = (low, bits) if rans.encoded_size(symbols) > size else (bits, high)
    return low


def _symbols(networks: Networks, codes: Codes) -> list[list[Symbols]]:
    """Every tensor of every network in whole steps, neurons in canonical order."""
    whole = np.rint(networks.weights() / weight_steps(networks, codes)).astype(np.int32)
    out = []
    for k, (row, count) in enumerate(zip(whole, networks.counts, strict=True)):
        parts = np.split(row[:count], networks.starts(k)[1:])
        out.append(sort_neurons([p.reshape(s) for p, s in zip(parts, networks.shapes(k), strict=True)]))
    return out


def _finest(networks: Networks) -> Codes:
    """The finest step codes at which the tensors' symbols fit in 15 bits."""
    largest = [[max(float(t.detach().abs().max()), 1e-9) for t in networks.tensors(k)] for k in range(len(networks))]
    return np.clip(np.floor(STEPS_PER_OCTAVE * np.log2(30_000 / np.array(largest))), 0, 127).astype(np.int64)


def _records(networks: Networks, codes: Codes, frames: list[Frame]) -> list[DhfRecord]:
    return [
        DhfRecord(
            quaternion=frame.quaternion,
            box=frame.box,
            fold=frame.fold,
            width=width,
            hidden_layers=networks.hidden_layers,
            omega_first=round(omega),
            omega_hidden=round(omega),
            step_codes=tuple(int(c) for c in of_network),
            symbols=tuple(symbols),
        )
        for frame, width, omega, of_network, symbols in zip(
            frames, networks.widths, networks.omegas, codes, _symbols(networks, codes), strict=True
        )
    ]


def _coded_size(records: list[DhfRecord]) -> int:
    return len(rans.encode([s for r in records for s in r.symbols]))
