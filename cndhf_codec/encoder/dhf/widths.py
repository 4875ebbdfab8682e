"""Choose the widths of a file's networks."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...format.constants import MAX_WIDTH
from ...format.container import parameter_count
from .settings import DhfSettings

STATE_BYTES = 1 + 4  # the number of fields, and the state of the coder
RECORD_BYTES = 25 + 14  # of a field of five hidden layers
FIELD_BYTES = RECORD_BYTES + 14  # record and scale codes
# Evidence for these constants: ADR 007; SIZE_AIM: 026; BASE_OMEGA_WIDTH, MOST_OMEGA_FACTOR: 009.
SIZE_AIM = 0.98  # widths and rounding aim at this share of the target size: the size is known only afterwards
LEAST_FITTED_WIDTH = 5
# Up to WIDEST_EQUAL all networks are equally wide. The weights of wider ones grow with a power of their shares, and a
# share counts as at least LEAST_SHARE.
WIDEST_EQUAL, SHARE_POWER, LEAST_SHARE = 25, 0.5, 1e-3
# Beyond this width omega grows with the width, up to this factor.
BASE_OMEGA_WIDTH, MOST_OMEGA_FACTOR = 24, 1.5


def widths_for(settings: DhfSettings, shares: list[float], other_bytes: int) -> list[int]:
    """Return the given width, or widths at which networks, one per share (see `Plan.shares`), fill the target size at
    the preset's bits per weight. The list is empty where there is no room.

    If a field with share s of the error and n weights leaves an error of s (s / n)^a, then n in proportion to s leaves
    the least. But a field with a small share also has its whole silhouette to learn: so n grows as s^SHARE_POWER, and
    up to WIDEST_EQUAL all networks are equally wide.
    """
    if settings.width is not None:
        return [settings.width] * len(shares)
    assert settings.target_size is not None
    room = settings.target_size * SIZE_AIM - STATE_BYTES - other_bytes - len(shares) * FIELD_BYTES
    parameters = room * 8 / settings.bits
    size = partial(parameter_count, hidden_layers=settings.hidden_layers)
    width = 0
    while width < WIDEST_EQUAL and len(shares) * size(width + 1) <= parameters:
        width += 1
    if width < LEAST_FITTED_WIDTH:
        return []
    widths = [width] * len(shares)
    if width < WIDEST_EQUAL:
        return widths
    needs = np.maximum(shares, LEAST_SHARE) ** SHARE_POWER
    while True:
        left = parameters - sum(map(size, widths))
        wider = [k for k, w in enumerate(widths) if w < MAX_WIDTH and size(w + 1) - size(w) <= left]
        if not wider:
            return widths
        widths[min(wider, key=lambda k: size(widths[k] + 1) / needs[k])] += 1


def omega_for(settings: DhfSettings, width: int) -> int:
    """Choose omega for a width: wider networks can follow finer detail, but learn it only with a larger omega."""
    return round(settings.omega * min(max(width / BASE_OMEGA_WIDTH, 1.0), MOST_OMEGA_FACTOR))
