"""The `paper` preset beside the figures that CN-DHF prints, with its fields and their widths.

    python tools/paper_table.py out.tsv rocker-arm fertility --levels 1,2 --steps 20000
    python tools/paper_table.py ablations.tsv fertility --levels 2 --steps 20000 --loss regression

CD is ours: exact point-to-surface, in the normalised frame. CD-paper is the paper's: tools/paper_floor.py says how it
is measured; the exact floor there is what exact height fields along the same axes have. The paper samples by stabbing
with random lines, which hit a surface in proportion to its area; here samples are drawn by area. All are times 1000.

Each row is written as soon as it is there; a run that is started again makes those that are missing.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from paper_floor import SAMPLES, Reference, corpus, exact_floor

from cndhf_codec import Model, encode
from cndhf_codec.encoder import settings as encoder_settings
from cndhf_codec.encoder.dhf.frames import Frame
from cndhf_codec.encoder.paper import fit
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.encoder.paper.steps import TileImages
from cndhf_codec.encoder.progress import Bar
from cndhf_codec.mesh.sampling import sample_surface

# The corpus's names of the paper's shapes, where they differ.
NAMES = {
    "rocker-arm": "rockerarm",
    "max-planck": "maxplank",
    "stanford-bunny": "441708",
    "lucy": "252119",
    "stanford-dragon": "dragon",
    "xyzrgb-dragon-100k": "xyzrgb",
}
# Neurons per layer by the parameters that the paper counts for one field, one less than there are in all but the first.
WIDTHS = {1617: 17, 2417: 21, 4801: 30, 9241: 42, 17401: 58, 43241: 92}
COLUMNS = [
    *("mesh", "faces", "level", "fields", "width", "parameters", "steps", "loss", "seconds", "bytes", "CD", "p99"),
    *("CD-paper", "sampling-floor", "exact-floor", "printed-parameters", "printed"),
]
KEY = ("mesh", "level", "fields", "width", "steps", "loss")


def printed(figures: Path, method: str = "cndhf") -> dict[tuple[str, int], tuple[int, float]]:
    """Parameters and CD-paper that the paper prints of a method, by name and level of detail: 1 to 4 are about 5, 10,
    20, 40 thousand parameters."""
    with figures.open(encoding="utf-8") as file:
        rows = csv.DictReader((line for line in file if not line.startswith("#")), delimiter="\t")
        return {(r["shape"], int(r["lod"])): (int(r[f"{method}_parameters"]), float(r[f"{method}_cd"])) for r in rows}


def fields_and_width(parameters: int) -> tuple[int, int]:
    """How many fields, and how wide, a printed count of parameters is of."""
    for fields in range(1, 5):
        if parameters % fields == 0 and parameters // fields in WIDTHS:
            return fields, WIDTHS[parameters // fields]
    raise click.ClickException(f"{parameters} parameters are no number of fields of {sorted(WIDTHS)}")


def regressing(images: TileImages) -> TileImages:
    """Targets of the rejected loss: beside the silhouette the near height is 1 and the far one -1."""
    hit = images.hit[..., None] == 1
    return images._replace(
        heights=np.where(hit, images.heights, np.array([1, -1], np.float32)),
        known=np.where(hit, images.known, np.float32(1)),
        hit=np.ones_like(images.hit),
    )


def use_loss(loss: str) -> None:
    if loss == "no-laplacian":
        encoder_settings.PRESETS["paper"] = replace(PAPER, laplacian=0.0)
    if loss == "regression":
        made = fit.tile_images
        fit.tile_images = lambda targets: regressing(made(targets))


class Table:
    """A file of rows, each written as soon as it is made. key: the columns that tell rows apart."""

    def __init__(self, path: Path, columns: Sequence[str], key: Sequence[str]) -> None:
        self._path, self._columns, self._key = path, columns, key
        if not path.exists():
            path.write_text("\t".join(columns) + "\n", encoding="utf-8")
        with path.open(encoding="utf-8") as file:
            self._there = {tuple(r[k] for k in key) for r in csv.DictReader(file, delimiter="\t")}

    def has(self, key: Mapping[str, object]) -> bool:
        return tuple(str(key[k]) for k in self._key) in self._there

    def add(self, row: Mapping[str, object]) -> None:
        line = "\t".join(str(row[c]) for c in self._columns)
        click.echo(line)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


def figures_of(model: Model, shape: Reference) -> dict[str, str]:
    """CD and p99 as the encoder has measured them, and CD-paper, all times 1000."""
    surface = model.to_mesh(512)
    points = sample_surface(shape.norm.apply(surface.vertices), surface.faces, SAMPLES, seed=3)
    d = model.report.normalised
    assert d is not None
    return {
        "CD": f"{d.mean * 1e3:.3f}",
        "p99": f"{d.p99 * 1e3:.2f}",
        "CD-paper": f"{1e3 * shape.cd_paper(points):.3f}",
    }


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--figures", type=click.Path(path_type=Path), help="paper-figures.tsv; beside the corpus by default.")
@click.option("--levels", default="1,2", show_default=True, help="Of detail, as the paper's figures count them.")
@click.option("--more-fields", default=0, show_default=True, help="Than the paper has; -1: one fewer.")
@click.option("--loss", type=click.Choice(["full", "no-laplacian", "regression"]), default="full", show_default=True)
@click.option("--steps", default=PAPER.steps, show_default=True, help="Of the fit of each field.")
@click.option("--threads", default=1, show_default=True)
def main(
    target: Path,
    names: tuple[str, ...],
    figures: Path | None,
    levels: str,
    more_fields: int,
    loss: str,
    steps: int,
    threads: int,
) -> None:
    figure = printed(figures or corpus().parent / "paper-figures.tsv")
    use_loss(loss)
    table = Table(target, COLUMNS, KEY)
    for name in names:
        shape: Reference | None = None
        for level in levels.split(","):
            count, error = figure[NAMES.get(name, name), int(level)]
            fields, width = fields_and_width(count)
            fields += more_fields
            key = dict(zip(KEY, (name, level, fields, width, steps, loss), strict=True))
            if fields < 1 or table.has(key):
                continue
            shape = shape or Reference.read(name)
            path = corpus() / f"{name}.ply"
            bar = Bar()
            model = encode(path, preset="paper", axes=fields, width=width, steps=steps, threads=threads, progress=bar)
            bar.close()
            frames = [Frame(record.quaternion, record.box) for record in model.container.dhfs]
            row = dict(
                key,
                faces=len(shape.solid.faces),
                fields=len(frames),
                parameters=model.info["parameters"],
                seconds=round(sum(model.report.seconds.values())),
                bytes=len(model.dumps()),
            )
            row |= figures_of(model, shape) | {
                "sampling-floor": f"{1e3 * shape.sampling_floor:.3f}",
                "exact-floor": f"{1e3 * exact_floor(shape, frames).cd_paper:.3f}",
                "printed-parameters": count,
                "printed": error,
            }
            table.add(row)


if __name__ == "__main__":
    main()
