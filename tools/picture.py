"""Render meshes and .cndhf files side by side: `python tools/picture.py out.png in.ply out.cndhf ...`.

Orthographic ray casting with embreex, one column a file; sizes in bytes are written under each.
"""

from __future__ import annotations

from pathlib import Path

import click
import matplotlib
import numpy as np

from cndhf_codec.encoder.solid import Solid
from cndhf_codec.report.compare import read_shape
from cndhf_codec.report.render import picture, view_frame

matplotlib.use("Agg")
from matplotlib import pyplot as plt


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("sources", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--azimuth", default=35.0, help="Degrees.")
@click.option("--elevation", default=25.0, help="Degrees.")
@click.option("--up", type=click.Choice(["y", "z"]), default="y")
@click.option("--size", default=480, help="Pixels a picture.")
def main(target: Path, sources: tuple[Path, ...], azimuth: float, elevation: float, up: str, size: int) -> None:
    frame = view_frame(azimuth, elevation, up)
    figure, axes = plt.subplots(1, len(sources), figsize=(len(sources) * size / 100, size / 100 + 0.35), squeeze=False)
    for axis, path in zip(axes[0], sources, strict=True):
        shape = read_shape(path, 384)
        centre = (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)) / 2
        scale = np.linalg.norm(shape.vertices - centre, axis=1).max()
        axis.imshow(picture(Solid((shape.vertices - centre) / scale, shape.faces), frame, 2 * size))
        axis.set_title(f"{shape.name}: {shape.bytes:,} bytes", fontsize=10)
        axis.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main()
