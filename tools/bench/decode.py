"""What decoding costs and gives, as ratios measured in one run: times of a shared machine mean little by themselves.

    python tools/bench/decode.py results/0.1/decode.tsv a.cndhf b.cndhf [--mesh a.ply --mesh b.ply] [--only mesh_256]

One function a row and file: it returns the ratio, its target where there is one, and the figures behind it. The
two sides of a ratio are timed alternately, and the least of each counts. --mesh names the originals, in the
order of the files, for the rows that measure errors.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from skimage import measure

import cndhf_codec
from cndhf_codec.decoder.dhf.table import HeightTable
from cndhf_codec.mesh.distances import surface_distances
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh

ROUNDS = 5


@dataclass(frozen=True)
class Row:
    ratio: float
    target: str
    figures: str


def least_times(*sides: Callable[[], Any], rounds: int = ROUNDS) -> list[tuple[float, float]]:
    """Least seconds, and least processor seconds, of each, run in turn `rounds` times."""
    times: list[list[tuple[float, float]]] = [[] for _ in sides]
    for _ in range(rounds):
        for side, own in zip(sides, times, strict=True):
            start = time.perf_counter(), time.process_time()
            side()
            own.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    return [(min(t[0] for t in own), min(t[1] for t in own)) for own in times]


def mesh_row(path: Path, resolution: int, target: str) -> Row:
    """to_mesh of a model just loaded, against scikit-image's marching cubes alone on a cube of resolution^3 nodes.

    The cube is that around the solid, and f there is that of the height tables: the networks' would take minutes.
    """
    model = cndhf_codec.load(path)
    lo, hi = ((x - model.container.centre) / model.container.scale for x in model.to_mesh(32).bounds)
    half = (hi - lo).max() / 2 * (1 + 2 / resolution)
    line = np.linspace(-half, half, resolution)
    tables = [HeightTable(dhf, line[1] - line[0]) for dhf in model._solid.dhfs]
    f = np.empty((resolution,) * 3, dtype=np.float32)
    for i, x in enumerate(line):
        plane = np.stack(np.meshgrid([x], line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        points = (plane + (lo + hi) / 2).astype(np.float32)
        parts = [dhf.implicit(points, table) for dhf, table in zip(model._solid.dhfs, tables, strict=True)]
        f[i] = np.minimum.reduce(parts).reshape(resolution, resolution)
    fresh = [cndhf_codec.load(path) for _ in range(ROUNDS)]  # nothing may be left of an earlier round
    (ours, own), (theirs, their_own) = least_times(
        lambda: fresh.pop().to_mesh(resolution), lambda: measure.marching_cubes(f, level=0.0)
    )
    return Row(
        ours / theirs,
        target,
        f"to_mesh {ours:.3f} s, marching_cubes {theirs:.3f} s; processor seconds {own:.3f} and {their_own:.3f}",
    )


def mesh_256(path: Path, original: Path | None) -> Row:
    return mesh_row(path, 256, "<= 0.7")


def mesh_512(path: Path, original: Path | None) -> Row:
    return mesh_row(path, 512, "<= 0.4")


def network(path: Path, original: Path | None) -> Row:
    """Heights of the first double height field at 2^18 points: numpy against torch's forward pass on the CPU."""
    import torch

    net = cndhf_codec.load(path)._solid.dhfs[0].network
    uv = np.random.default_rng(0).uniform(-0.5, 0.5, (2**18, 2)).astype(np.float32)
    layers = [(torch.tensor(W), torch.tensor(b[:, 0])) for W, b in zip(net.matrices, net.biases, strict=True)]
    points = torch.tensor(uv)

    def forward() -> torch.Tensor:
        with torch.inference_mode():
            x = points
            for W, b in layers[:-1]:
                x = torch.sin(torch.nn.functional.linear(x, W, b))
            return torch.nn.functional.linear(x, *layers[-1])

    np.testing.assert_allclose(net(uv), forward().numpy(), atol=1e-4)
    (ours, _), (theirs, _) = least_times(lambda: net(uv), forward, rounds=3 * ROUNDS)
    each = 1e9 / len(uv)
    return Row(ours / theirs, "<= 1.5", f"numpy {each * ours:.0f} ns a point, torch {each * theirs:.0f} ns")


def start_up(path: Path, original: Path | None) -> Row:
    """A new interpreter that imports the package and loads a file, against one that imports numpy.

    Processor seconds: what other work on the machine takes is not in them. Both find compiled modules, as in an
    installation.
    """
    commands = [
        [sys.executable, "-c", f"import cndhf_codec; cndhf_codec.load({str(path)!r})"],
        [sys.executable, "-c", "import numpy"],
    ]
    runs: list[list[float]] = [[], []]
    with tempfile.TemporaryDirectory() as cache:
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = cache
        for command in commands:
            subprocess.run(command, check=True, env=environment)
        for _ in range(21):
            for command, times in zip(commands, runs, strict=True):
                before = children_seconds()
                subprocess.run(command, check=True, env=environment)
                times.append(children_seconds() - before)
    a, b = (float(np.median(times)) for times in runs)
    return Row(a / b, "<= 1.3", f"medians: import and load {a:.3f} s, import numpy {b:.3f} s")


def children_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def intersection(path: Path, original: Path | None) -> Row:
    """Triangles of the intersection surface against those of marching cubes at 512, where its CD is within 2 %."""
    model = cndhf_codec.load(path)
    if original is None:
        raise click.UsageError(f"{path}: name its original with --mesh")
    mesh = read_mesh(original)
    norm = normalisation(mesh)
    figures = []
    for label, options in (("marching cubes", {"resolution": 512}), ("intersection", {"method": "intersection"})):
        start = time.perf_counter()
        out = model.to_mesh(**options)
        seconds = time.perf_counter() - start
        d = surface_distances(
            norm.apply(mesh.vertices), mesh.faces, norm.apply(np.asarray(out.vertices)), np.asarray(out.faces)
        )
        figures.append((label, len(out.faces), d.mean * 1e3, seconds, out.is_watertight))
    text = "; ".join(
        f"{label}: {n} faces, CD {cd:.4f}, {seconds:.2f} s, watertight: {closed}"
        for label, n, cd, seconds, closed in figures
    )
    change = 100 * (figures[1][2] / figures[0][2] - 1)
    return Row(figures[1][1] / figures[0][1], "<= 0.2, CD within 2 %", f"CD {change:+.1f} %; {text}")


def contains(path: Path, original: Path | None) -> Row:
    """`contains` of a model just loaded, its cells yet to be made, against trimesh's with embreex on its surface: 10
    million points drawn uniformly from the surface's box. Answers differ where the mesh is not the surface."""
    mesh = cndhf_codec.load(path).to_mesh(256)
    assert "embree" in type(mesh.ray).__module__
    points = np.random.default_rng(0).uniform(*mesh.bounds, (10_000_000, 3)).astype(np.float32)
    wide = points.astype(np.float64)  # what trimesh turns them into
    mesh.contains(wide[:1000])  # its tree is made before the clock starts
    answers = {}

    def ours() -> None:
        answers["ours"] = cndhf_codec.load(path).contains(points)

    def theirs() -> None:
        answers["theirs"] = mesh.contains(wide)

    (a, _), (b, _) = least_times(ours, theirs, rounds=2)
    differ = (answers["ours"] != answers["theirs"]).mean()
    f = cndhf_codec.load(path).implicit(points[::10])
    wrong = (answers["ours"][::10] != (f >= 0)).sum()
    figures = f"ours {a:.2f} s, embree {b:.2f} s, {100 * differ:.3f} % differ; from f itself {wrong} of {len(f)}"
    return Row(b / a, ">= 20 (times as fast)", figures)


ROWS = {
    "mesh_256": mesh_256,
    "mesh_512": mesh_512,
    "intersection": intersection,
    "contains": contains,
    "network": network,
    "start_up": start_up,
}


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--mesh", "meshes", multiple=True, type=click.Path(path_type=Path, exists=True))
@click.option("--only", multiple=True, type=click.Choice(list(ROWS)))
def main(out: Path, files: tuple[Path, ...], meshes: tuple[Path, ...], only: tuple[str, ...]) -> None:
    originals = [*meshes, *[None] * (len(files) - len(meshes))]
    lines = ["row\tfile\tratio\ttarget\tfigures"]
    for name in only or ROWS:
        for path, original in zip(files, originals, strict=True):
            row = ROWS[name](path, original)
            lines.append(f"{name}\t{path.name}\t{row.ratio:.2f}\t{row.target}\t{row.figures}")
            print(lines[-1], flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
