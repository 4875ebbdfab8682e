"""How wide the networks of a file are."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...format.constants import MAX_WIDTH
from ...format.container import parameter_count
from .settings import DhfSettings

FILE_BYTES = 40 + 2 * 6 + 4 + 4  # header, section table, checksum and coder state of a file without metadata
RECORD_BYTES = 40  # of a field, without its step codes
FIELD_BYTES = RECORD_BYTES + 14  # record and scale codes of a field of five hidden layers
# Evidence for these constants: ADR 007; SIZE_AIM: 026; BASE_OMEGA_WIDTH, MOST_OMEGA_FACTOR: 009.
SIZE_AIM = 0.98  # of the size asked for is what widths and rounding aim at: the size is known only afterwards
LEAST_FITTED_WIDTH = 5
# Up to this width all networks are equally wide. The weights of wider ones grow with a power of their shares, of which
# no share counts as less than the least.
WIDEST_EQUAL, SHARE_POWER, LEAST_SHARE = 25, 0.5, 1e-3
# Beyond this width omega grows with the width, up to this factor.
BASE_OMEGA_WIDTH, MOST_OMEGA_FACTOR = 24, 1.5


def widths_for(settings: DhfSettings, shares: list[float], metadata_bytes: int) -> list[int]:
    """The width asked for, or those at which networks, one per share (see `Plan.shares`), fill the target size at the
    preset's bits per weight; none where there is no room.

    If the error of a field whose share of it is s falls with its number of weights n as s (s / n)^a, then n in
    proportion to s leaves the least; but a field of a small share has its whole silhouette to learn, too: n grows as
    s^SHARE_POWER, and while none is wider than WIDEST_EQUAL all are equally wide.
    """
    if settings.width is not None:
        return [settings.width] * len(shares)
    assert settings.target_size is not None
    room = settings.target_size * SIZE_AIM - FILE_BYTES - metadata_bytes - len(shares) * FIELD_BYTES
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
    """Networks of more weights can follow finer detail, but learn it only where omega lets them."""
    return round(settings.omega * min(max(width / BASE_OMEGA_WIDTH, 1.0), MOST_OMEGA_FACTOR))
