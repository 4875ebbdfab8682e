"""Render meshes and .cndhf files side by side: `python tools/picture.py out.png in.ply out.cndhf ...`.

Orthographic ray casting with embreex, one column a file; sizes in bytes are written under each.
"""

from __future__ import annotations

from pathlib import Path

import click
import matplotlib
import numpy as np

import cndhf_codec
from cndhf_codec.encoder.read import read_mesh
from cndhf_codec.encoder.solid import Solid
from cndhf_codec.report.render import shade, view_frame, visible

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    if path.suffix == ".cndhf":
        surface = cndhf_codec.load(path).to_mesh(384)
        return np.asarray(surface.vertices), np.asarray(surface.faces)
    mesh = read_mesh(path)
    return mesh.vertices, mesh.faces


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
        vertices, faces = load(path)
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        scale = np.linalg.norm(vertices - centre, axis=1).max()
        solid = Solid((vertices - centre) / scale, faces)
        image = shade(solid, frame, visible(solid, frame, 2 * size)[0])
        axis.imshow(image.reshape(2 * size, 2 * size, 3))
        axis.set_title(f"{path.name}: {path.stat().st_size:,} bytes", fontsize=10)
        axis.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main()
