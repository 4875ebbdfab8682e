"""CN-DHF's tables, measured again: its rivals, the published method and ours on the same meshes.

    python tools/bench/paper_tables.py results/paper fertility rocker-arm --levels 1,2
    python tools/bench/paper_tables.py /tmp/quick --quick

Methods: siren_sdf, nglod, vqad, idf (tools/bench/rivals); `paper`, the published method's preset; `dhf` and `surface`,
with a preset that takes no longer than a rival's training. Levels 1 to 4 are about 5, 10, 20 and 40 thousand
parameters, and the bytes of BYTES for `dhf` and `surface`. Writes OUT/points.tsv, a row per mesh, method, level and
seed, as soon as it is there: a run that is started again makes those that are missing. Also coverage.tsv, and what
paper_report.py makes of the rows.

Errors are those of measure.py against the input (CD, p99, max, normals); CD-paper is that of tools/paper_floor.py. A
rival has them for its weights as trained, and "CD of bytes" and "normals of bytes" for the rounded ones that its bytes
hold; ours are measured as decoded from files. Seconds are processor time of the fit, with one thread.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from pathlib import Path

import click
import numpy as np
import torch
import trimesh
from measure import Reference
from paper_report import COLUMNS, KEY, METHODS, RIVALS, load_rows, report, save_rows
from rate_distortion import Row, mesh_path
from rivals import networks
from rivals.samples import Samples, samples_of

import cndhf_codec
from cndhf_codec.encoder.paper.axes import choose_axes
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.format.container import parameter_count
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.sampling import sample_surface

sys.path.insert(0, str(Path(__file__).parents[1]))
import paper_floor
from paper_table import NAMES, fields_and_width, printed

# The most parameters that the paper's fields have at each level, as we count them.
PARAMETERS = {1: 4851, 2: 9604, 3: 18484, 4: 43242}
BYTES = {1: 4096, 2: 8192, 3: 16_384, 4: 32_768}
MOST_FIELDS = 3  # of the published method where the paper has no figure of fields
PAPER_STEPS = 20_000  # of each field, meant to take no longer than a rival; docs/paper.md has what more bring
TRIAL_STEPS = 1000  # of a fit that tells how many fields to take
RESOLUTION = 512  # cells of our meshes, of height fields
QUICK, QUICK_STEPS = ("rocker-arm", "fertility"), 1500

Made = tuple[Row, networks.Mesh]


class Shape:
    """An input, and what is needed of it, made when it is asked for."""

    def __init__(self, name: str, cache: Path, share: float) -> None:
        self.name, self.path = name, mesh_path(name)
        self.mesh = read_mesh(self.path)
        self._cache, self._share = cache, share

    @cached_property
    def reference(self) -> Reference:
        return Reference(self.mesh)

    @cached_property
    def paper(self) -> paper_floor.Reference:
        return paper_floor.Reference.read(self.path.stem)

    @cached_property
    def samples(self) -> Samples:
        return samples_of(self.paper.solid, self._cache, self._share)

    def row(self, about: dict[str, object], exact: networks.Mesh, stored: networks.Mesh) -> Row:
        """Figures of two meshes in the input's frame: of the weights as trained, and of what a file has of them."""
        points = sample_surface(self.paper.norm.apply(exact[0]), exact[1], paper_floor.SAMPLES, seed=3)
        figures = {**self.reference.figures(exact), "CD-paper": 1e3 * self.paper.cd_paper(points)}
        again = figures if stored is exact else self.reference.figures(stored)
        figures |= {f"{name} of bytes": again[name] for name in ("CD", "normals")}
        return {k: f"{v:.4g}" if isinstance(v, float) else str(v) for k, v in {**about, **figures}.items()}


def rival(shape: Shape, method: str, level: int, seed: int, steps: int | None, resolution: int) -> Made:
    torch.manual_seed(seed)
    module = import_module(f"rivals.{method}")
    network = module.build(shape.samples, PARAMETERS[level], level)
    steps = steps or network.steps
    start = time.process_time()
    networks.train(network, shape.samples, steps, seed)
    seconds = time.process_time() - start
    back, size = networks.rounded(network, shape.samples, steps, seed)

    def given(of: networks.Network) -> networks.Mesh:
        vertices, faces = networks.mesh_of(of, shape.samples, resolution)
        return shape.paper.norm.undo(vertices), faces

    about = {"parameters": network.size, "bytes": size, "fields": "-", "steps": steps, "seconds": seconds}
    mesh = given(network)
    return shape.row(about, mesh, given(back)), mesh


def ours(shape: Shape, method: str, level: int, seed: int, steps: int | None, preset: str, figures: Path) -> Made:
    options: dict[str, object]
    if method == "paper":
        count, width = paper_fields(shape, level, figures)
        options = {"preset": "paper", "axes": count, "width": width, "steps": steps or PAPER_STEPS}
    else:
        options = {"preset": preset, "representation": method, "target_size": BYTES[level]}
    start = time.process_time()
    model = cndhf_codec.encode(shape.path, **options, seed=seed, threads=1)  # type: ignore[arg-type]
    seconds = time.process_time() - start
    made = model.to_mesh(*(() if method == "surface" else (RESOLUTION,)))
    mesh = np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int64)
    about = {
        "parameters": model.info.get("parameters", "-"),
        "bytes": len(model.dumps()),
        "fields": len(model.container.dhfs) or "-",
        "steps": options.get("steps", "-"),
        "seconds": seconds,
    }
    return shape.row(about, mesh, mesh), mesh


def paper_fields(shape: Shape, level: int, figures: Path) -> tuple[int, int]:
    """How many fields, and how wide: the paper's, or else those of which a short fit has the least error."""
    if figures.exists():
        known = printed(figures).get((NAMES.get(shape.name, shape.name), level))
        if known:
            return fields_and_width(known[0])
    tried = []
    for count in range(1, MOST_FIELDS + 1):
        width = 4
        while count * parameter_count(width + 1, PAPER.hidden_layers) <= PARAMETERS[level]:
            width += 1
        model = cndhf_codec.encode(shape.path, preset="paper", axes=count, width=width, steps=TRIAL_STEPS, threads=1)
        tried.append((model.report.normalised.mean, len(model.container.dhfs), width))
    return min(tried)[1:]


def coverage(shape: Shape) -> Row:
    """Shares of the surface that the paper's choice of 1 to 4 axes sees, and that any candidate sees, in per cent."""
    chosen = choose_axes(shape.paper.solid, replace(PAPER, max_axes=4, coverage=1.0), 0, 1)
    seen = [*chosen.covered, *4 * [chosen.covered[-1]]][:4]
    return {"mesh": shape.name, **{str(k + 1): f"{100 * s:.2f}" for k, s in enumerate(seen)}} | {
        "visible": f"{100 * chosen.visible:.2f}"
    }


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1)
@click.option("--levels", default="1,2", show_default=True, help="Of detail, as the paper's tables count them.")
@click.option("--methods", default=",".join(METHODS), show_default=True)
@click.option("--seeds", default="0", show_default=True)
@click.option("--steps", type=click.IntRange(1), help="Of rivals and of each of `paper`'s fields.  [default: theirs]")
@click.option("--share", default=1.0, show_default=True, help="Of the rivals' million samples.")
@click.option("--resolution", default=networks.RESOLUTION, show_default=True, help="Of the rivals' meshes.")
@click.option("--cache", type=click.Path(path_type=Path), default=Path("build/rivals"), show_default=True)
@click.option("--figures", type=click.Path(path_type=Path), help="paper-figures.tsv; beside the corpus by default.")
@click.option("--preset", default="fast", show_default=True, help="Of `dhf` and `surface`.")
@click.option("--quick", is_flag=True, help="Level 1 of two meshes by all methods, with few steps.")
def main(
    out: Path,
    names: tuple[str, ...],
    levels: str,
    methods: str,
    seeds: str,
    steps: int | None,
    share: float,
    resolution: int,
    cache: Path,
    figures: Path | None,
    preset: str,
    quick: bool,
) -> None:
    torch.set_num_threads(1)
    figures = figures or paper_floor.corpus().parent / "paper-figures.tsv"
    if quick:
        names, levels, steps = names or QUICK, "1", steps or QUICK_STEPS
    store, files = out / "points.tsv", out / "files"
    files.mkdir(parents=True, exist_ok=True)
    rows, covered = load_rows(store), load_rows(out / "coverage.tsv")
    wanted = [
        (name, method, level, seed)
        for level in levels.split(",")
        for name in names
        for seed in seeds.split(",")
        for method in methods.split(",")
    ]
    have = {tuple(r[k] for k in KEY) for r in rows}
    missing = [w for w in wanted if w not in have]
    shape: Shape | None = None
    failed = []
    for k, (name, method, level, seed) in enumerate(missing):
        click.echo(f"{k + 1} of {len(missing)}: {name}, {method}, level {level}, seed {seed}")
        if shape is None or shape.name != name:
            shape = Shape(name, cache, share)
        if name not in {r["mesh"] for r in covered}:
            covered.append(coverage(shape))
            save_rows(out / "coverage.tsv", covered, tuple(covered[0]))
        try:
            if method in RIVALS:
                row, mesh = rival(shape, method, int(level), int(seed), steps, resolution)
            else:
                row, mesh = ours(shape, method, int(level), int(seed), steps, preset, figures)
        except (cndhf_codec.CndhfError, ValueError) as exc:
            failed.append(f"{name}, {method}, level {level}: {exc}")
            continue
        rows.append({**dict(zip(KEY, (name, method, level, seed), strict=True)), **row})
        save_rows(store, rows, COLUMNS)
        if (level, seed) == ("1", "0"):
            trimesh.Trimesh(*mesh, process=False).export(files / f"{name}+{method}.ply")
    report(out, rows, figures)
    for message in failed:
        click.echo(f"failed: {message}", err=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
