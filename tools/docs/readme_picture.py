"""The picture of the README: `python tools/docs/readme_picture.py docs/picture.png MESH FILE.cndhf [--up z]`.

Three renderings side by side: the input, the best mesh of Draco that is no larger than FILE.cndhf, and FILE.cndhf.
Needs the extra `bench`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import matplotlib
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

import peers

from cndhf_codec.mesh.distances import surface_distances
from cndhf_codec.mesh.solid import Solid
from cndhf_codec.report.compare import read_shape
from cndhf_codec.report.render import picture, view_frame

matplotlib.use("Agg")
from matplotlib import pyplot as plt


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("mesh", type=click.Path(exists=True, path_type=Path))
@click.argument("file", type=click.Path(exists=True, path_type=Path))
@click.option("--azimuth", default=35.0, help="Degrees.")
@click.option("--elevation", default=15.0, help="Degrees.")
@click.option("--up", type=click.Choice(["y", "z"]), default="y")
@click.option("--size", default=420, help="Pixels along the side of a rendering.")
def main(target: Path, mesh: Path, file: Path, azimuth: float, elevation: float, up: str, size: int) -> None:
    """Render MESH, its best peer and FILE to TARGET."""
    given, ours = read_shape(mesh), read_shape(file)
    centre = (given.vertices.min(axis=0) + given.vertices.max(axis=0)) / 2
    scale = np.linalg.norm(given.vertices - centre, axis=1).max()
    diagonal = float(np.linalg.norm(np.ptp(given.vertices, axis=0)))

    def error(vertices: np.ndarray, faces: np.ndarray) -> float:
        return surface_distances(given.vertices, given.faces, vertices, faces, samples=50_000).mean / diagonal * 100

    # Face counts in finer steps than those of the bench, around the largest that fit.
    fitting = [point for point in peers.draco(given.vertices, given.faces) if point[1] <= ours.bytes]
    most = max(int(point[0].split()[2]) for point in fitting)
    peers.FACES[:] = [round(most * 1.03**k) for k in range(-4, 14)]
    points = [point for point in peers.draco(given.vertices, given.faces) if 0.9 * ours.bytes < point[1] <= ours.bytes]
    best = min(points, key=lambda point: error(*point[2]))
    shown = [
        (f"input: {len(given.faces):,} faces", given.vertices, given.faces),
        (f"simplified, Draco: {best[1]:,} bytes, error {error(*best[2]):.3f} %", *best[2]),
        (f"cndhf: {ours.bytes:,} bytes, error {error(ours.vertices, ours.faces):.3f} %", ours.vertices, ours.faces),
    ]
    click.echo(f"peer: {best[0]}")
    frame = view_frame(azimuth, elevation, up)
    images = [picture(Solid((vertices - centre) / scale, faces), frame, 2 * size) for _, vertices, faces in shown]
    used = np.any([(image < 1).any(axis=2) for image in images], axis=0)
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    tall, wide = np.ptp(rows) + 1, np.ptp(columns) + 1
    figure, axes = plt.subplots(1, len(shown), figsize=(len(shown) * size / 100, size / 100 * tall / wide + 0.4))
    for axis, image, (title, _, _) in zip(axes, images, shown, strict=True):
        axis.axis("off")
        axis.imshow(image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
        axis.set_title(title, fontsize=10)
    figure.tight_layout(pad=0.4)
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main()
