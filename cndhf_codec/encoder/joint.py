"""Our method: all double height fields are fitted and rounded together, to a given size."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch

from ..decoder.model import Model
from ..errors import CndhfError, EncodeError, OptionError
from ..format import Container, DhfRecord, rans
from ..format.constants import MAX_WIDTH, STEPS_PER_OCTAVE
from ..format.container import Symbols, parameter_count
from .axisset import AxisCosts
from .composite import Composite, Network
from .fit import fit_all, one_torch_thread
from .heights import Frame, frame_for_axis, height_targets
from .progress import Stage
from .rounding import matrices, relative_steps, round_networks, step_codes
from .samples import draw_samples
from .settings import Settings
from .solid import Solid
from .tune import tune
from .verify import surface_distances

FILE_BYTES = 40 + 2 * 6 + 4 + 4  # header, section table, checksum and coder state of a file without metadata
DHF_BYTES = 40 + 14  # record and scale codes of a DHF of five hidden layers
LEAST_WIDTH = 5
AIM = 0.98  # of the size asked for is what the rounding aims at: the size is known only afterwards
WITHIN = 0.95  # of the size asked for is the least that is good enough
ATTEMPTS = 3
BITS_RANGE = (3.0, 12.0)
TRIAL_SAMPLES, TRIAL_RESOLUTION, TRIAL_POINTS = 100_000, 96, 20_000
MORE_AXES = 0.97  # another axis must win by this factor


def encode_joint(
    solid: Solid, settings: Settings, metadata_bytes: int, seed: int, device: torch.device, threads: int, stage: Stage
) -> tuple[list[DhfRecord], float, float, float]:
    """DHF records, and the shares of surface that the chosen and that any axes see, and of rays through holes.

    metadata_bytes: size of the metadata section with its row in the table.
    """
    with one_torch_thread():
        plan = make_plan(solid, settings, metadata_bytes, seed, device, threads, stage)
        if plan.visible == 0:
            return [], 0.0, 0.0, 0.0
        networks, composite, unknown = fit_plan(solid, plan, settings, seed, device, threads, stage)
        records = round_to_size(networks, composite, plan, settings, metadata_bytes, seed, threads, stage)
    return records, plan.covered, plan.visible, unknown


@dataclass(frozen=True, eq=False)
class Plan:
    """Axes (as frames) and width of the networks; the shares are of the input's surface."""

    frames: list[Frame]
    width: int
    covered: float
    visible: float


def make_plan(
    solid: Solid, settings: Settings, metadata_bytes: int, seed: int, device: torch.device, threads: int, stage: Stage
) -> Plan:
    """Choose the number of axes by short trial fits at the size asked for, and with it the width."""
    stage("axes", 1)
    costs = AxisCosts(solid, seed, threads)
    most = 1 if costs.visible == 0 else settings.max_axes or 1
    options: list[Plan] = []
    for count in range(1, most + 1):
        width = settings.width or width_for(settings, count, metadata_bytes)
        if width < LEAST_WIDTH:
            break
        chosen = costs.best(count)
        frames = [frame_for_axis(costs.axes[i], solid.vertices) for i in chosen]
        options.append(Plan(frames, width, costs.covered(chosen), costs.visible))
    if not options:
        raise OptionError(f"a target size of {settings.target_size} bytes is too small for one double height field")
    if len(options) == 1 or settings.trial_steps == 0:
        return options[-1]
    report = stage("plan", len(options))
    best, least = options[0], math.inf
    for k, plan in enumerate(options):
        error = _trial(solid, plan, settings, seed, device, threads)
        report(k + 1, error)
        if error < least * MORE_AXES:
            best, least = plan, error
    return best


def width_for(settings: Settings, count: int, metadata_bytes: int) -> int:
    """The width at which `count` networks fill the target size at the preset's bits a weight."""
    assert settings.target_size is not None
    room = settings.target_size * AIM - FILE_BYTES - metadata_bytes - count * DHF_BYTES
    parameters = room * 8 / settings.bits / count
    width = 0
    while width < MAX_WIDTH and parameter_count(width + 1, settings.hidden_layers) <= parameters:
        width += 1
    return width


def fit_plan(
    solid: Solid, plan: Plan, settings: Settings, seed: int, device: torch.device, threads: int, stage: Stage
) -> tuple[list[Network], Composite, float]:
    """Fit every DHF alone, then all together. Returns networks, samples, and the share of rays through holes."""
    targets = [height_targets(solid, f, settings.target_resolution) for f in plan.frames]
    report = stage("fit", settings.steps * len(targets))
    settings = replace(settings, width=plan.width)
    fitted = fit_all(targets, settings, seed, device, threads, lambda done, total, loss: report(done, loss))
    networks = [[torch.from_numpy(t).to(device).requires_grad_() for t in n] for n in fitted]
    samples = draw_samples(solid, plan.frames, settings.samples, seed)
    composite = Composite(samples, plan.frames, settings.omega, device)
    tune(
        networks,
        composite,
        settings,
        settings.tune_steps,
        settings.tune_rate,
        seed,
        stage("tune", settings.tune_steps),
    )
    return networks, composite, max(t.unknown for t in targets)


def round_to_size(
    networks: list[Network],
    composite: Composite,
    plan: Plan,
    settings: Settings,
    metadata_bytes: int,
    seed: int,
    threads: int,
    stage: Stage,
) -> list[DhfRecord]:
    """Round the networks, so that the file has the size asked for. Raises EncodeError when it cannot be met."""
    start = [[t.detach().clone() for t in n] for n in networks]
    fixed = FILE_BYTES + metadata_bytes + 40 * len(networks)
    room = None if settings.target_size is None else settings.target_size - fixed
    aim = 0.0 if room is None else room * AIM
    best: list[DhfRecord] | None = None
    fewest: float = math.inf
    with ThreadPoolExecutor(threads) as pool:
        logs = relative_steps(networks, matrices(networks, composite, seed, pool))
        for attempt in range(ATTEMPTS):
            bits = settings.bits if room is None else _bits_for(networks, logs, aim)
            codes = step_codes(networks, logs, bits)
            report = stage("round", max(settings.rounds - 1, 1) * settings.round_steps)
            round_networks(networks, composite, settings, codes, seed + attempt, pool, report)
            symbols = [_symbols(n, c) for n, c in zip(networks, codes, strict=True)]
            size = len(rans.encode([s for part in symbols for s in part]))
            strays = composite.strays(networks)
            # A floater that rounding has made goes away with other samples, as a rule.
            if (room is None or size <= room) and strays < fewest:
                fewest = strays
                best = [
                    _record(f, settings, plan.width, c, s) for f, c, s in zip(plan.frames, codes, symbols, strict=True)
                ]
                enough = room is None or size + fixed >= WITHIN * (room + fixed)
                if enough and (strays == 0 or attempt > 0):
                    break
            if room is not None and not WITHIN * room <= size <= room:
                aim *= AIM * room / size
            for network, tensors in zip(networks, start, strict=True):
                for t, s in zip(network, tensors, strict=True):
                    t.data.copy_(s)
    if best is None:
        raise EncodeError(f"no file of {settings.target_size} bytes or less was reached; ask for a larger size")
    return best


def _trial(solid: Solid, plan: Plan, settings: Settings, seed: int, device: torch.device, threads: int) -> float:
    """Chamfer distance (normalised) after a short fit; infinite when it leaves nothing."""
    short = replace(
        settings,
        steps=settings.trial_steps // 3,
        tune_steps=settings.trial_steps,
        samples=TRIAL_SAMPLES,
        target_resolution=256,
    )
    networks, _, _ = fit_plan(solid, plan, short, seed, device, threads, lambda name, total: lambda done, loss: None)
    fine = [[_finest(t) for t in n] for n in networks]
    records = [
        _record(f, settings, plan.width, c, _symbols(n, c)) for f, c, n in zip(plan.frames, fine, networks, strict=True)
    ]
    try:
        surface = Model(Container((0.0, 0.0, 0.0), 1.0, tuple(records))).to_mesh(TRIAL_RESOLUTION)
    except CndhfError:
        return math.inf
    return surface_distances(solid.vertices, solid.faces, surface.vertices, surface.faces, seed, TRIAL_POINTS).chamfer


def _bits_for(networks: list[Network], logs: npt.NDArray[np.float64], size: float) -> float:
    """Bits a weight at which the plainly rounded networks take `size` bytes."""
    low, high = BITS_RANGE
    for _ in range(12):
        bits = (low + high) / 2
        codes = step_codes(networks, logs, bits)
        symbols = [s for n, c in zip(networks, codes, strict=True) for s in _symbols(n, c)]
        low, high = (low, bits) if rans.encoded_size(symbols) > size else (bits, high)
    return low


def _symbols(network: Network, codes: list[int]) -> list[Symbols]:
    return [
        np.rint(t.detach().cpu().numpy().astype(np.float64) * 2 ** (c / STEPS_PER_OCTAVE)).astype(np.int32)
        for t, c in zip(network, codes, strict=True)
    ]


def _finest(tensor: torch.Tensor) -> int:
    """The finest step code at which a tensor's symbols fit in 15 bits."""
    largest = max(float(tensor.detach().abs().max()), 1e-9)
    return int(min(max(math.floor(STEPS_PER_OCTAVE * math.log2(30_000 / largest)), 0), 127))


def _record(frame: Frame, settings: Settings, width: int, codes: list[int], symbols: list[Symbols]) -> DhfRecord:
    return DhfRecord(
        quaternion=frame.quaternion,
        box=frame.box,
        width=width,
        hidden_layers=settings.hidden_layers,
        omega_first=settings.omega,
        omega_hidden=settings.omega,
        step_codes=tuple(codes),
        symbols=tuple(symbols),
    )
