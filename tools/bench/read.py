"""What reading meshes costs against trimesh, as ratios measured in one run: `python tools/bench/read.py [--faces N]`.

A ring with waves of so many faces is written in every format; each file is read in turn by this package and by
trimesh, whose vertices and faces are then checked and sorted as ours are. The least of three times counts.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import trimesh

from cndhf_codec.mesh.read import checked, read_mesh

ROUNDS = 3
# Formats, and how many of the faces each file has: text takes longer.
FILES = {"ply": 1.0, "glb": 0.2, "obj": 0.2, "off": 0.2, "stl": 0.2, "ascii.ply": 0.1}


def ring(faces: int) -> trimesh.Trimesh:
    """A closed surface of about so many faces."""
    n = max(4, round(np.sqrt(faces / 2)))
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(n) * 2 * np.pi / n, indexing="ij")
    tube = 0.4 + 0.02 * np.sin(9 * u) * np.sin(7 * v)
    points = np.stack(
        [(1 + tube * np.cos(v)) * np.cos(u), (1 + tube * np.cos(v)) * np.sin(u), tube * np.sin(v)], axis=2
    )
    a = np.arange(n * n).reshape(n, n)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3)
    return trimesh.Trimesh(points.reshape(-1, 3).astype(np.float32), triangles, process=False)


def by_trimesh(path: Path) -> Any:
    loaded = trimesh.load(path, process=False, force="mesh")
    return checked(np.asarray(loaded.vertices), np.asarray(loaded.faces), str(path))


def seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


@click.command()
@click.option("--faces", type=int, default=5_000_000, show_default=True, help="Of the binary PLY; others have fewer.")
def main(faces: int) -> None:
    print("| file | faces | MB | ours, s | trimesh, s | ratio |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for kind, share in FILES.items():
            path = Path(folder) / f"ring.{kind}"
            mesh = ring(round(faces * share))
            options = {"encoding": "ascii"} if kind.startswith("ascii") else {}
            mesh.export(path, file_type=kind.split(".")[-1], **options)
            times = [
                (seconds(lambda p=path: read_mesh(p)), seconds(lambda p=path: by_trimesh(p))) for _ in range(ROUNDS)
            ]
            ours, theirs = (min(column) for column in zip(*times, strict=True))
            size = path.stat().st_size / 1e6
            print(f"| {path.name} | {len(mesh.faces)} | {size:.0f} | {ours:.2f} | {theirs:.2f} | {ours / theirs:.2f} |")
            path.unlink()


if __name__ == "__main__":
    main()
