"""What an encoder gives the pipeline."""

from __future__ import annotations

from typing import NamedTuple

from ..format import DhfRecord


class Encoded(NamedTuple):
    """covered, visible: shares of the surface that the chosen and that any axes see. unknown: share of the rays that
    meet a face from behind, through a hole. No records where no axis sees anything."""

    records: list[DhfRecord]
    covered: float
    visible: float
    unknown: float
