"""Turn networks and step codes into the records of a file."""

from __future__ import annotations

import numpy as np

from ...arrays import I64
from ...format import DhfRecord, rans
from ...format.constants import STEPS_PER_OCTAVE
from ...format.container import Symbols
from .frames import Frame
from .network.siren import Networks
from .rounding.feedback import Codes, weight_steps
from .rounding.symmetries import sort_neurons

LARGEST_SYMBOL = 30_000  # at the finest steps: within 15 bits, with some to spare


def records_of(networks: Networks, codes: Codes, frames: list[Frame]) -> list[DhfRecord]:
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
            frames, networks.widths, networks.omegas, codes, symbols_of(networks, codes), strict=True
        )
    ]


def symbols_of(networks: Networks, codes: Codes) -> list[list[Symbols]]:
    """Round every tensor of every network to whole steps, with neurons sorted."""
    whole = np.rint(networks.weights() / weight_steps(networks, codes)).astype(np.int32)
    out = []
    for k, (row, count) in enumerate(zip(whole, networks.counts, strict=True)):
        parts = np.split(row[:count], networks.starts(k)[1:])
        out.append(sort_neurons([p.reshape(s) for p, s in zip(parts, networks.shapes(k), strict=True)]))
    return out


def finest_codes(networks: Networks) -> I64:
    """Find the finest step codes (K, tensors) at which the tensors' symbols fit in 15 bits."""
    largest = [[max(float(t.detach().abs().max()), 1e-9) for t in networks.tensors(k)] for k in range(len(networks))]
    return np.clip(np.floor(STEPS_PER_OCTAVE * np.log2(LARGEST_SYMBOL / np.array(largest))), 0, 127).astype(np.int64)


def coded_size(records: list[DhfRecord]) -> int:
    """Size of the weights, in bytes."""
    return len(rans.encode([s for r in records for s in r.symbols]))
