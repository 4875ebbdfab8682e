"""What each choice that CN-DHF leaves open does to preset `paper`: a row per shape and reading.

    python tools/paper_readings.py out.tsv rocker-arm moai
    python tools/paper_readings.py out.tsv horse lucy --fields 2 --width 17 --only "as used" --only "no Laplacian"

CD and CD-paper as in tools/paper_table.py. A batch of another size has as many steps as give equal work. Each row is
written as soon as it is there; a run that is started again makes those that are missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from paper_floor import Reference, corpus
from paper_table import Table, figures_of

from cndhf_codec import encode
from cndhf_codec.encoder import settings as encoder_settings
from cndhf_codec.encoder.dhf.network.siren import Networks
from cndhf_codec.encoder.paper import encode as paper_encode
from cndhf_codec.encoder.paper import fit
from cndhf_codec.encoder.paper.settings import PAPER, PaperSettings

COLUMNS = ("mesh", "reading", "fields", "width", "steps", "seconds", "CD", "p99", "CD-paper")
KEY = COLUMNS[:5]
# What is not as the preset has it.
READINGS: dict[str, dict[str, Any]] = {
    "as used": {},
    "omega 15": {"omega": 15},
    "omega 60": {"omega": 60},
    "rate 3e-4": {"learning_rate": 3e-4},
    "rate 3e-3": {"learning_rate": 3e-3},
    "rate that does not fall": {},
    "batch of 1,024": {"batch": 1024},
    "batch of 16,384": {"batch": 16384},
    "images of 128 pixels": {"target_resolution": 128},
    "images of 192 pixels": {"target_resolution": 192},
    "images of 320 pixels": {"target_resolution": 320},
    "images of 512 pixels": {"target_resolution": 512},
    "images of 1,024 pixels": {"target_resolution": 1024},
    "no Laplacian": {"laplacian": 0.0},
    "Laplacian of weight 10": {"laplacian": 10.0},
    "C = 0.01": {"margin": 0.01},
    "heights of at most 1": {},
}


def with_heights_to_one(targets: Any, settings: PaperSettings, *rest: Any) -> Networks:
    """Fit heights divided by the greatest one, and C with them; the last layer multiplies them again."""
    sides = ((targets.near, targets.near_known), (targets.far, targets.far_known))
    greatest = np.float32(max(np.abs(heights[known]).max() for heights, known in sides))
    smaller = replace(targets, near=targets.near / greatest, far=targets.far / greatest)
    network = fit.fit_paper(smaller, replace(settings, margin=settings.margin / greatest), *rest)
    network.theta[0, -(2 * settings.width + 2) :] *= float(greatest)
    return network


@contextmanager
def reading(name: str, steps: int) -> Iterator[None]:
    """Have the preset follow a reading, and take so many steps."""
    plain = PAPER, fit.cosine_schedule, paper_encode.fit_paper
    encoder_settings.PRESETS["paper"] = replace(PAPER, steps=steps, **READINGS[name])
    if name == "rate that does not fall":
        fit.cosine_schedule = lambda warm, done: min(warm, 1.0)
    if name == "heights of at most 1":
        paper_encode.fit_paper = with_heights_to_one
    try:
        yield
    finally:
        encoder_settings.PRESETS["paper"], fit.cosine_schedule, paper_encode.fit_paper = plain


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--fields", default=1, show_default=True)
@click.option("--width", default=PAPER.width, show_default=True, help="Of each field; 4,802 parameters by default.")
@click.option("--only", multiple=True, type=click.Choice(list(READINGS)), help="Readings.  [default: all]")
@click.option("--steps", default=10_000, show_default=True, help="Of batches of the preset's size.")
@click.option("--threads", default=1, show_default=True)
def main(
    target: Path, names: tuple[str, ...], fields: int, width: int, only: tuple[str, ...], steps: int, threads: int
) -> None:
    table = Table(target, COLUMNS, KEY)
    for name in names:
        shape = Reference.read(name)
        for read in only or READINGS:
            taken = steps * PAPER.batch // READINGS[read].get("batch", PAPER.batch)
            key = dict(zip(KEY, (name, read, fields, width, taken), strict=True))
            if table.has(key):
                continue
            with reading(read, taken):
                model = encode(corpus() / f"{name}.ply", preset="paper", axes=fields, width=width, threads=threads)
            seconds = round(sum(model.report.seconds.values()))
            table.add({**key, "seconds": seconds, **figures_of(model, shape)})


if __name__ == "__main__":
    main()
