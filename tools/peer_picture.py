"""Render one mesh as it is, as its best peer, as a surface and as height fields, at equal bytes: a row for each size.

    python tools/peer_picture.py OUT.png MESH FILES POINTS.tsv [--sizes 1KiB,4KiB] [--azimuth ...]

FILES is a folder of `MESH-surface-1KiB.cndhf`, `MESH-dhf-1KiB.cndhf` and so on; what is not there is left out.
POINTS.tsv is of `bench/rate_distortion.py`: the peer is the point of least mean error that has at most a tenth more
bytes than the size, and is made again. Files are drawn as they are decoded by default. CD is the mean error times 1000
in the normalised frame. Needs the extra `bench`.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from picture import plt, save

sys.path.insert(0, str(Path(__file__).resolve().parent / "bench"))

import cndhf_codec
from cndhf_codec.arrays import F64, I64
from cndhf_codec.mesh.lengths import parse_size
from cndhf_codec.mesh.read import Mesh, read_mesh
from cndhf_codec.mesh.solid import Solid
from cndhf_codec.report.render import picture, view_frame

ALLOWED = 1.1  # of the size: a peer's sizes come in steps
MARGIN = 12  # pixels


class Cell(NamedTuple):
    title: str
    vertices: F64
    faces: I64


def best_peer(points: Path, mesh: Mesh, name: str, size: int) -> Cell:
    import peers

    with points.open(newline="") as lines:
        rows = [r for r in csv.DictReader(lines, delimiter="\t") if r["mesh"] == name and r["budget"] == "-"]
    rows = [r for r in rows if int(r["bytes"]) <= ALLOWED * size]
    if not rows:
        raise click.ClickException(f"{points}: no peer of {name} has {size} bytes or fewer; measure it first")
    best = min(rows, key=lambda r: float(r["CD"]))
    kind, *_, count, _ = best["method"].split()
    peers.FACES[:] = [int(count)]
    made = {"draco": peers.draco, "meshopt": peers.meshopt}[kind](mesh.vertices, mesh.faces)
    vertices, faces = next(point[2] for point in made if point[0] == best["method"])
    return Cell(f"{kind}: {int(best['bytes']):,} bytes, CD {float(best['CD']):.3g}", vertices, faces)


def ours(path: Path, kind: str) -> Cell | None:
    if not path.exists():
        return None
    model = cndhf_codec.load(path)
    error = 1000 * model.container.metadata.mean_error / model.container.scale
    mesh = model.to_mesh()
    title = f"{kind}: {path.stat().st_size:,} bytes, CD {error:.3g}"
    return Cell(title, np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("mesh", type=click.Path(exists=True, path_type=Path))
@click.argument("files", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("points", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--sizes", default="1KiB,4KiB")
@click.option("--azimuth", default=35.0, help="Degrees.")
@click.option("--elevation", default=15.0, help="Degrees.")
@click.option("--up", type=click.Choice(["y", "z"]), default="y")
@click.option("--size", "pixels", default=330, help="Pixels along the side of a rendering.")
def main(
    target: Path,
    mesh: Path,
    files: Path,
    points: Path,
    sizes: str,
    azimuth: float,
    elevation: float,
    up: str,
    pixels: int,
) -> None:
    """Render MESH four ways to TARGET."""
    given, name = read_mesh(mesh), mesh.stem
    kinds = [kind for kind in ("surface", "dhf") if list(files.glob(f"{name}-{kind}-*.cndhf"))]
    columns = 2 + len(kinds)
    whole = Cell(f"{name}: {len(given.faces):,} faces", given.vertices, given.faces)
    cells: list[Cell | None] = []
    for size in sizes.split(","):
        cells += [whole, best_peer(points, given, name, parse_size(size))]
        cells += [ours(files / f"{name}-{kind}-{size}.cndhf", kind) for kind in kinds]
    centre = (given.vertices.min(axis=0) + given.vertices.max(axis=0)) / 2
    scale = np.linalg.norm(given.vertices - centre, axis=1).max()
    frame = view_frame(azimuth, elevation, up)

    def drawn(cell: Cell) -> np.ndarray:
        return picture(Solid((cell.vertices - centre) / scale, cell.faces), frame, 2 * pixels)

    first = drawn(whole)
    used = (first < 1).any(axis=2)
    tall, wide = (np.flatnonzero(used.any(axis=axis)) for axis in (1, 0))
    box = tuple(slice(max(at[0] - MARGIN, 0), at[-1] + MARGIN) for at in (tall, wide))
    rows = len(cells) // columns
    height = pixels * len(tall) / len(wide)
    figure, axes = plt.subplots(
        rows, columns, figsize=(columns * pixels / 100, rows * (height / 100 + 0.3)), squeeze=False
    )
    for axis, cell in zip(axes.flat, cells, strict=True):
        axis.axis("off")
        if cell is not None:
            axis.imshow((first if cell is whole else drawn(cell))[box], interpolation="antialiased")
            axis.set_title(cell.title, fontsize=8)
    figure.tight_layout(pad=0.2)
    save(figure, target)
    click.echo(f"{target}: {target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
