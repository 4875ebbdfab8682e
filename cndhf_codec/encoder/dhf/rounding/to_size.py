"""Round networks to the target size."""

from __future__ import annotations

import math

from ....arrays import F64
from ....errors import EncodeError
from ....format import DhfRecord, rans
from ...deadline import Deadline
from ..fit.loss import JointLoss
from ..job import Job, Plan
from ..network.siren import Networks
from ..records import coded_size, records_of, symbols_of
from ..widths import RECORD_BYTES, SIZE_AIM
from .feedback import Rounding, gauss_newton_matrices, relative_steps, round_networks, step_codes
from .gauss_newton import Draw
from .symmetries import fold_biases

# Evidence for these constants: ADR 026.
LEAST_FILL = 0.95  # least share of the target size that is good enough
ATTEMPTS = 3
FIRST_SHARE = 0.7  # of the time left goes to the first attempt
MOST_ARTIFACTS = 2.0  # times the artifacts before rounding; with more, another attempt follows
BITS_RANGE = (3.0, 12.0)  # per weight


def round_to_size(job: Job, plan: Plan, networks: Networks, loss: JointLoss, deadline: Deadline) -> list[DhfRecord]:
    """Round the networks so that the file has the target size. Raises EncodeError when no attempt is small enough."""
    settings = job.settings
    fixed = job.other_bytes + 1 + RECORD_BYTES * len(networks)
    room = None if settings.target_size is None else settings.target_size - fixed
    aim = 0.0 if room is None else room * SIZE_AIM
    networks = fold_biases(networks)
    best: list[DhfRecord] | None = None
    fewest: float = math.inf
    allowed = math.inf if settings.one_attempt else MOST_ARTIFACTS * loss.artifacts(networks)
    matrices = gauss_newton_matrices(networks, loss, Draw(job.seed, settings.samples_per_weight), job.threads)
    logs = relative_steps(networks, matrices)
    for attempt in range(ATTEMPTS):
        bits = settings.bits if room is None else _bits_for(networks, logs, aim)
        rounding = Rounding(settings, step_codes(networks, logs, bits), matrices, job.seed + attempt)
        report = job.stage("round", max(settings.rounds - 1, 1) * settings.round_steps)
        rounded = networks.copy()
        time_left = deadline.part(1 if attempt else FIRST_SHARE)
        round_networks(rounded, loss, rounding, job.threads, report, time_left)
        records = records_of(rounded, rounding.codes, plan.frames)
        size = coded_size(records)
        artifacts = 0.0 if settings.one_attempt else loss.artifacts(rounded)
        if (room is None or size <= room) and artifacts < fewest:
            fewest, best = artifacts, records
        if settings.one_attempt and best is not None:
            break
        # Artifacts that rounding has made usually go away with other samples; those that were there before stay.
        enough = room is None or LEAST_FILL * (room + fixed) <= size + fixed <= room + fixed
        if enough and (artifacts <= allowed or attempt > 0):
            break
        if best is not None and deadline.passed() > 1 - FIRST_SHARE / 2:
            break  # another attempt would be over time
        if room is not None and not LEAST_FILL * room <= size <= room:
            aim *= SIZE_AIM * room / size
    if best is None:
        raise EncodeError(f"no file of {settings.target_size} bytes or less was reached; ask for a larger size")
    return best


def _bits_for(networks: Networks, logs: F64, size: float) -> float:
    """Find the bits per weight at which networks, rounded without feedback, take `size` bytes."""
    low, high = BITS_RANGE
    for _ in range(12):
        bits = (low + high) / 2
        symbols = [s for part in symbols_of(networks, step_codes(networks, logs, bits)) for s in part]
        low, high = (low, bits) if rans.encoded_size(symbols) > size else (bits, high)
    return low
