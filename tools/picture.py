"""Render meshes and .cndhf files side by side: `python tools/picture.py out.png in.ply out.cndhf ...`.

Orthographic ray casting with embreex; the name and the size in bytes are written over each.
"""

from __future__ import annotations

import io
from pathlib import Path

import click
import matplotlib
import numpy as np
from PIL import Image

from cndhf_codec.mesh.solid import Solid
from cndhf_codec.report.compare import read_shape
from cndhf_codec.report.render import picture, view_frame

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

COLOURS = 48


def save(figure: Figure, target: Path) -> None:
    """Write a figure of renderings with few colours: they have shades of one."""
    png = io.BytesIO()
    figure.savefig(png, dpi=100)
    Image.open(png).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("sources", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--azimuth", default=35.0, help="Degrees.")
@click.option("--elevation", default=25.0, help="Degrees.")
@click.option("--up", type=click.Choice(["y", "z"]), default="y")
@click.option("--size", default=480, help="Pixels a picture.")
@click.option("--columns", type=click.IntRange(1), help="Pictures in a row.  [default: all]")
def main(
    target: Path, sources: tuple[Path, ...], azimuth: float, elevation: float, up: str, size: int, columns: int | None
) -> None:
    frame = view_frame(azimuth, elevation, up)
    columns = columns or len(sources)
    rows = -(-len(sources) // columns)
    inches = columns * size / 100, rows * (size / 100 + 0.35)
    figure, axes = plt.subplots(rows, columns, figsize=inches, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, path in zip(axes.flat, sources, strict=False):
        shape = read_shape(path)
        centre = (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)) / 2
        scale = np.linalg.norm(shape.vertices - centre, axis=1).max()
        axis.imshow(picture(Solid((shape.vertices - centre) / scale, shape.faces), frame, 2 * size))
        axis.set_title(f"{shape.name}: {shape.bytes:,} bytes", fontsize=10)
    figure.tight_layout(pad=0.3)
    save(figure, target)


if __name__ == "__main__":
    main()
