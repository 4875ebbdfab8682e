"""Where the bytes of surface files go, and Draco's bytes for the same control mesh on the same grid.

    python tools/bench/surface_bytes.py FILES

Draco (level 10) stores no sharp marks; the ratio is that of our whole file, container and marks included, over Draco's.
"""

from __future__ import annotations

import math
from pathlib import Path

import click
import DracoPy
import numpy as np

import cndhf_codec
from cndhf_codec.format import ControlMesh
from cndhf_codec.format.surface.connectivity import encode_connectivity
from cndhf_codec.format.surface.marks import encode_marks
from cndhf_codec.format.surface.positions import best_eighths, code_positions, told_of, walk_of
from cndhf_codec.format.surface.range_coder import RangeEncoder
from cndhf_codec.format.surface.section import HEAD_SIZE

COLUMNS = ("file", "vertices", "sharp edges", "bytes", "connectivity", "marks", "positions", "rest", "draco", "ratio")


def parts_of(mesh: ControlMesh) -> tuple[int, int, int]:
    """Bytes of connectivity, marks and positions. mesh: as it was decoded, whose numbering is the coder's own."""
    encoder = RangeEncoder()
    encode_connectivity(encoder, mesh.faces)
    connectivity = len(encoder.finish())
    encoder = RangeEncoder()
    encode_marks(encoder, mesh.faces, mesh.sharp)
    marks = len(encoder.finish())
    walk = walk_of(mesh.faces)
    eighths, positions = best_eighths(told_of(walk), mesh.positions), []
    for repeats in (False, True):
        encoder = RangeEncoder()
        code_positions(encoder, walk, eighths, repeats, mesh.positions)
        positions.append(len(encoder.finish()))
    return connectivity, marks, min(positions)


def draco_bytes(mesh: ControlMesh) -> int:
    """Bytes of Draco with the grid of the file, so that it is lossless too."""
    points = mesh.positions - mesh.positions.min(axis=0)
    bits = max(1, math.ceil(math.log2(int(points.max()) + 1)))
    data = DracoPy.encode(
        points.astype(np.float32),
        mesh.faces.astype(np.uint32),
        quantization_bits=bits,
        quantization_range=float(2**bits - 1),
        quantization_origin=np.zeros(3, dtype=np.float32),
        compression_level=10,
    )
    back = np.asarray(DracoPy.decode(data).points)
    # Draco numbers anew and may drop nothing: the same points, in any order.
    assert np.array_equal(np.unique(np.rint(back), axis=0), np.unique(points, axis=0))
    return len(data)


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
def main(files: tuple[Path, ...]) -> None:
    click.echo("\t".join(COLUMNS))
    for path in files:
        mesh = cndhf_codec.load(path).container.surface
        if mesh is None:
            continue
        size, draco = path.stat().st_size, draco_bytes(mesh)
        parts = parts_of(mesh)
        rest = size - sum(parts)
        assert rest > HEAD_SIZE
        cells = (path.stem, len(mesh.positions), len(mesh.sharp), size, *parts, rest, draco, f"{size / draco:.2f}")
        click.echo("\t".join(map(str, cells)))


if __name__ == "__main__":
    main()
