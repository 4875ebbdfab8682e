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

matplotlib.use("Agg")
from matplotlib import pyplot as plt

LIGHT = np.array([0.3, 0.4, 0.87])
WARM = np.array([0.93, 0.86, 0.76])


def load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    if path.suffix == ".cndhf":
        surface = cndhf_codec.load(path).to_mesh(384)
        return np.asarray(surface.vertices), np.asarray(surface.faces)
    mesh = read_mesh(path)
    return mesh.vertices, mesh.faces


def view_frame(azimuth: float, elevation: float, up: str) -> np.ndarray:
    """(3, 3) rows right, up, towards the eye; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    right = np.array([np.cos(a), 0, -np.sin(a)])
    frame = np.stack([right, np.cross(eye, right), eye])
    return frame if up == "y" else frame[:, [2, 0, 1]]


def shade(vertices: np.ndarray, faces: np.ndarray, frame: np.ndarray, size: int) -> np.ndarray:
    """(size, size, 3) image of a mesh inside the unit ball."""
    solid = Solid(vertices, faces)
    side = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(side, -side)
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1) @ frame
    hit = solid.first_hits(origins, -frame[2])
    normals = solid.normals[hit] @ frame.T
    normals *= np.where(normals[:, 2:] < 0, -1, 1)  # an open surface is looked at from both sides
    lambert = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1) * 0.8 + 0.2 * normals[:, 2].clip(0, 1)
    image = np.where(hit[:, None] >= 0, lambert[:, None] * WARM, 1.0)
    return image.reshape(size, size, 3)


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
        axis.imshow(shade((vertices - centre) / scale, faces, frame, size * 2))
        axis.set_title(f"{path.name}: {path.stat().st_size:,} bytes", fontsize=10)
        axis.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(target, dpi=100)


if __name__ == "__main__":
    main()
