"""What meshes a file of double height fields gives: triangles, megabytes as binary PLY, errors, seconds.

    python tools/bench/meshes.py OUT.tsv --pair horse.ply horse.cndhf --pair ... [--faces]

One row per file and way of decoding: the whole grid at 256 with specks, which was the default once, and the default;
with --faces also 500 to 20,000 triangles by both methods. Errors are in percent of the input's diagonal.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np

import cndhf_codec
from cndhf_codec.decoder.meshfile import mesh_bytes
from cndhf_codec.mesh.distances import surface_distances
from cndhf_codec.mesh.read import read_mesh

WAYS: dict[str, dict[str, Any]] = {"grid 256": {"resolution": 256, "specks": True}, "default": {}}
METHODS = ("marching-cubes", "intersection")
COUNTS = (500, 2000, 5000, 20_000)
COLUMNS = ("file", "way", "triangles", "megabytes", "mean", "p99", "maximum", "pieces", "seconds")


def row(original: Any, path: Path, way: str, options: dict[str, Any]) -> str:
    model = cndhf_codec.load(path)
    start = time.perf_counter()
    try:
        mesh = model.to_mesh(**options)
    except cndhf_codec.CndhfError as exc:
        return f"{path.stem}\t{way}\t{exc}"
    seconds = time.perf_counter() - start
    found = surface_distances(
        original.vertices, original.faces, np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64)
    )
    diagonal = float(np.linalg.norm(np.ptp(original.vertices, axis=0)))
    errors = [f"{100 * value / diagonal:.4f}" for value in (found.mean, found.p99, found.maximum)]
    megabytes = len(mesh_bytes(mesh, "ply")[0]) / 1e6
    assert mesh.is_watertight
    values = (path.stem, way, len(mesh.faces), f"{megabytes:.2f}", *errors, mesh.body_count, f"{seconds:.1f}")
    return "\t".join(map(str, values))


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--pair", "pairs", multiple=True, nargs=2, type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--faces", is_flag=True)
def main(out: Path, pairs: tuple[tuple[Path, Path], ...], faces: bool) -> None:
    """Write the table."""
    ways = dict(WAYS)
    if faces:
        ways = {f"{n}, {method}": {"faces": n, "method": method} for method in METHODS for n in COUNTS}
        ways |= {f"{n}, grid 512": {"faces": n, "resolution": 512} for n in COUNTS}
    lines = ["\t".join(COLUMNS)]
    for mesh, file in pairs:
        original = read_mesh(mesh)
        for way, options in ways.items():
            lines.append(row(original, file, way, options))
            print(lines[-1], flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
    main()
