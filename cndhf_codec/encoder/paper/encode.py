"""The published method: axes by area, every double height field fitted alone, weights rounded finely."""

from __future__ import annotations

import math

import torch

from ...format import DhfRecord
from ...mesh.solid import Solid
from ..deadline import Deadline
from ..dhf.fit.single import fit_all, one_torch_thread
from ..dhf.frames import frame_for_axis, height_targets
from ..progress import Stage
from ..settings import Settings
from ..thread_pool import Team
from .axes import choose_axes
from .quantise import quantise


def encode_paper(
    solid: Solid, settings: Settings, seed: int, device: torch.device, threads: int, stage: Stage, deadline: Deadline
) -> tuple[list[DhfRecord], float, float, float]:
    """DHF records, and the shares of surface that the chosen and that any axes see, and of rays through holes."""
    stage("axes", 1)
    choice = choose_axes(solid, seed, threads, settings.rarity, settings.coverage, settings.max_axes)
    if choice.visible == 0:
        return [], 0.0, 0.0, 0.0
    frames = [frame_for_axis(axis, solid.vertices) for axis in choice.axes]
    targets = [height_targets(solid, f, settings.target_resolution) for f in frames]
    on_fit = stage("fit", settings.steps * len(targets))
    with one_torch_thread(), Team(threads) as team:
        alike = [settings] * len(targets)
        fitted = fit_all(targets, alike, seed, device, team, lambda done, total, loss: on_fit(done, loss), deadline)
    on_rounded = stage("round", len(targets))
    records = []
    for k, (network, target) in enumerate(zip(fitted, targets, strict=True)):
        tensors = [t.numpy() for t in network.tensors(0)]
        records.append(quantise(tensors, target, settings, seed))
        on_rounded(k + 1, math.nan)
    return records, float(choice.covered[-1]), choice.visible, max(t.unknown for t in targets)
