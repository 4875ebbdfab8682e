"""The published method beside ours at equal parameters.

    python tools/bench/equal_parameters.py results/0.1 armadillo horse --budgets 4096,8192

For every file of preset `default` that tools/bench/rate_distortion.py has left in <out>/files, a `paper` file is made
of as many double height fields as the published method takes, and as narrow as gives it no fewer parameters than
ours. Both are decoded and measured as that tool does it. Writes <out>/equal_parameters.tsv; what it already has is not
done again.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

import cndhf_codec
from cndhf_codec.encoder.paper.axes import choose_axes
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.format.container import parameter_count
from cndhf_codec.mesh.prepare import prepare
from cndhf_codec.mesh.read import Mesh, read_mesh

sys.path.insert(0, str(Path(__file__).parent))
from rate_distortion import Row, load_rows, mesh_path, row, save_rows

COLUMNS = (
    *("mesh", "budget", "our fields", "our width", "our parameters", "our bytes", "our CD"),
    *("paper fields", "paper width", "paper parameters", "paper bytes", "paper CD", "ours over paper"),
)


def measured(model: cndhf_codec.Model, mesh: Mesh, prefix: str) -> Row:
    surface = model.to_mesh(384)
    out = np.asarray(surface.vertices), np.asarray(surface.faces)
    return {
        f"{prefix} fields": str(len(model.container.dhfs)),
        f"{prefix} width": " ".join(str(d.width) for d in model.container.dhfs),
        f"{prefix} parameters": str(model.info["parameters"]),
        f"{prefix} bytes": str(model.info["bytes"]),
        f"{prefix} CD": row(mesh, out, {})["CD"],
    }


def compare(out: Path, name: str, budget: str) -> Row:
    ours = cndhf_codec.load(out / "files" / f"{mesh_path(name).stem}-default-{budget}.cndhf")
    solid = prepare(mesh_path(name)).solid
    axes = choose_axes(solid, PAPER, 0, 1).axes
    width = 4
    while len(axes) * parameter_count(width, PAPER.hidden_layers) < ours.info["parameters"]:
        width += 1
    paper = cndhf_codec.encode(mesh_path(name), preset="paper", width=width)
    mesh = read_mesh(mesh_path(name))
    found = {"mesh": name, "budget": budget, **measured(ours, mesh, "our"), **measured(paper, mesh, "paper")}
    return {**found, "ours over paper": f"{float(found['our CD']) / float(found['paper CD']):.3f}"}


@click.command()
@click.argument("out", type=click.Path(path_type=Path, exists=True))
@click.argument("names", nargs=-1, required=True)
@click.option("--budgets", default="4096,8192", show_default=True, help="Bytes of our files.")
def main(out: Path, names: tuple[str, ...], budgets: str) -> None:
    target = out / "equal_parameters.tsv"
    rows = load_rows(target)
    have = {(r["mesh"], r["budget"]) for r in rows}
    work = [(n, b) for b in budgets.split(",") for n in names if (n, b) not in have]
    for name, budget in tqdm(work, unit="file"):
        rows.append(compare(out, name, budget))
        save_rows(target, rows, COLUMNS)
    for budget in budgets.split(","):
        shares = [float(r["ours over paper"]) for r in rows if r["budget"] == budget]
        if shares:
            click.echo(f"{budget} bytes: ours over paper, mean of {len(shares)}: {np.mean(shares):.3f}")


if __name__ == "__main__":
    main()
