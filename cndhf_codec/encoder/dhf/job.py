"""The data that the stages of an encode share."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...mesh.solid import Solid
from ..progress import Stage
from ..thread_pool import ThreadPool
from .frames import Frame
from .settings import DhfSettings
from .widths import widths_for


@dataclass(frozen=True, eq=False)
class Job:
    """What all stages need. other_bytes: of the file, besides the body of its shape."""

    solid: Solid
    settings: DhfSettings
    other_bytes: int
    seed: int
    threads: ThreadPool
    stage: Stage


@dataclass(frozen=True, eq=False)
class Plan:
    """Axes (as frames) and the widths of their networks.

    shares: share of the surface for which each axis is the best, or, after a trial, of the loss that its field answers
    for. error_lower_bound: about the mean error of the exact height fields (normalised units). covered, visible: shares
    of the input's surface that these axes see, and that any axes see.
    """

    frames: list[Frame]
    shares: list[float]
    widths: list[int]
    error_lower_bound: float
    covered: float
    visible: float


def with_shares(plan: Plan, shares: list[float], job: Job) -> Plan:
    """Return the plan with other shares, and the widths that follow from them."""
    return replace(plan, shares=shares, widths=widths_for(job.settings, shares, job.other_bytes))
