"""Small jobs, plans and networks for the tests of the joint method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.job import Job, Plan
from cndhf_codec.encoder.dhf.network.siren import Networks, initialise, stacked
from cndhf_codec.encoder.dhf.settings import DEFAULT, DhfSettings
from cndhf_codec.encoder.dhf.widths import widths_for
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.mesh.solid import Solid

SMALL = replace(DEFAULT, batch=512, rounds=2, round_steps=30)


def job_of(solid: Solid, options: DhfSettings) -> Job:
    return Job(solid, options, 30, 0, ThreadPool(1), stage=lambda name, total: lambda done, loss: None)


def plan_of(job: Job, frames: list, shares: list[float]) -> Plan:
    return Plan(frames, shares, widths_for(job.settings, shares, 30), 0.0, 1.0, 1.0)


def networks(width: int = 8, count: int = 2) -> Networks:
    return of_widths(*[width] * count)


def of_widths(*widths: int) -> Networks:
    return stacked([initialise(w, 5, 30.0, torch.Generator().manual_seed(k)) for k, w in enumerate(widths)])


def used(nets: Networks) -> np.ndarray:
    """(K, P): which numbers of theta are weights, not padding."""
    return np.arange(nets.theta.shape[1]) < np.array(nets.counts)[:, None]


def quiet(step: int, loss: float) -> None:
    """Report no progress."""


class Looks(Deadline):
    """A deadline after a number of checks, in place of seconds."""

    def __init__(self, looks: int) -> None:
        super().__init__()
        self._left, self._looks = looks, looks

    def passed(self) -> float:
        self._left -= 1
        return 1 - (self._left + 1) / self._looks
