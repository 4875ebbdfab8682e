"""The result of a preset's method, for the pipeline."""

from __future__ import annotations

from typing import NamedTuple

from ..format import DhfRecord


class Encoded(NamedTuple):
    """Records of a file, and how they were found. There are none where no axis sees anything.

    covered, visible: shares of the surface that the chosen axes see, and that any axes see. unknown: share of the rays
    that meet a face from behind, through a hole.
    """

    records: list[DhfRecord]
    covered: float
    visible: float
    unknown: float
