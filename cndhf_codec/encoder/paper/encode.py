"""Encode by the published method: axes by area, single fits only, weights rounded finely."""

from __future__ import annotations

import math
from functools import partial

from ...mesh.solid import Solid
from ..deadline import Deadline
from ..dhf.fit.single import fit_each, one_torch_thread
from ..dhf.fit.targets import height_targets
from ..dhf.frames import frame_for_axis
from ..encoded import Encoded
from ..progress import Stage
from ..thread_pool import ThreadPool
from .axes import choose_axes
from .fit import fit_paper
from .quantise import quantise
from .settings import PaperSettings


def encode_paper(
    solid: Solid, settings: PaperSettings, seed: int, threads: int, stage: Stage, deadline: Deadline
) -> Encoded:
    stage("axes", 1)
    choice = choose_axes(solid, settings, seed, threads)
    if choice.visible == 0:
        return Encoded([], 0.0, 0.0, 0.0)
    frames = [frame_for_axis(axis, solid.vertices) for axis in choice.axes]
    targets = [height_targets(solid, f, settings.target_resolution) for f in frames]
    fits = [partial(fit_paper, of_field, settings, seed + k, deadline) for k, of_field in enumerate(targets)]
    on_step = stage("fit", settings.steps * len(targets))
    with one_torch_thread(), ThreadPool(threads) as pool:
        fitted = fit_each(fits, pool, on_step)
    on_rounded = stage("round", len(targets))
    records = []
    for k, (network, target) in enumerate(zip(fitted, targets, strict=True)):
        tensors = [t.numpy() for t in network.tensors(0)]
        records.append(quantise(tensors, target, settings, seed))
        on_rounded(k + 1, math.nan)
    return Encoded(records, float(choice.covered[-1]), choice.visible, max(t.unknown for t in targets))
