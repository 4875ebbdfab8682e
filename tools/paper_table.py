"""The `paper` preset beside the figures that CN-DHF prints.

    python tools/paper_table.py out.tsv rocker-arm fertility --axes 1 --widths 30 --steps 100000

CD is ours: exact point-to-surface, in the normalised frame. CD-paper is the paper's: 5 million samples of each surface,
nearest point to nearest point, mean of both directions, in the frame whose longest box side is 1 (docs/paper.md says
how that is known). The paper samples by stabbing with random lines, which hit a surface in proportion to its area; here
the samples are drawn by area. Both are times 1000.
"""

from __future__ import annotations

import os
from pathlib import Path

import click
import numpy as np
from scipy.spatial import cKDTree

from cndhf_codec import encode
from cndhf_codec.arrays import F64
from cndhf_codec.encoder.progress import Bar
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.sampling import sample_surface

SAMPLES = 5_000_000
# The paper's table: CD-paper by total parameter count.
PRINTED = {
    "stanford-bunny": {5: 0.53, 10: 0.43, 20: 0.36, 40: 0.32},
    "rocker-arm": {5: 0.36, 10: 0.33, 20: 0.31, 40: 0.30},
    "lucy": {5: 1.29, 10: 0.80, 20: 0.62, 40: 0.50},
    "fertility": {5: 0.57, 10: 0.40, 20: 0.35, 40: 0.32},
    "max-planck": {5: 0.36, 10: 0.31, 20: 0.29, 40: 0.28},
}


def cd_paper(a: F64, b: F64, longest: float) -> float:
    """Of points (N, 3) of two surfaces; longest: box side, by which lengths are divided."""
    forth = cKDTree(b).query(a, workers=-1)[0].mean()
    back = cKDTree(a).query(b, workers=-1)[0].mean()
    return float(forth + back) / 2 / longest


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--widths", default="17,30", show_default=True)
@click.option("--preset", default="paper", show_default=True)
@click.option("--axes", type=int, help="At most this many double height fields.")
@click.option("--steps", type=int, help="Of the fit of each field; the preset's by default.")
def main(target: Path, names: tuple[str, ...], widths: str, preset: str, axes: int | None, steps: int | None) -> None:
    corpus = Path(os.environ.get("CNDHF_CORPUS", Path(__file__).parents[2] / "shared" / "corpus"))
    rows = ["mesh\tsteps\twidth\tdhfs\tparameters\tbytes\tCD\tp99\tmax\tCD-paper\tsampling floor\tprinted\tseconds"]
    for name in names:
        mesh = read_mesh(corpus / f"{name}.ply")
        norm = normalisation(mesh)
        vertices = norm.apply(mesh.vertices)
        longest = float(np.ptp(vertices, axis=0).max())
        truth = sample_surface(vertices, mesh.faces, SAMPLES, seed=1)
        # What two samplings of the same surface give: no reconstruction can do better.
        floor = cd_paper(truth, sample_surface(vertices, mesh.faces, SAMPLES, seed=2), longest)
        for width in (int(w) for w in widths.split(",")):
            bar = Bar()
            model = encode(corpus / f"{name}.ply", preset=preset, axes=axes, width=width, steps=steps, progress=bar)
            report = model.report
            bar.close()
            surface = model.to_mesh(512)
            points = sample_surface(norm.apply(surface.vertices), surface.faces, SAMPLES, seed=3)
            d = report.normalised
            assert d is not None
            parameters = model.info["parameters"]
            listed = " ".join(f"{k}k:{v}" for k, v in PRINTED.get(name, {}).items()) or "-"
            rows.append(
                f"{name}\t{steps or 'preset'}\t{width}\t{len(model.container.dhfs)}\t{parameters}\t"
                f"{len(model.dumps())}\t"
                f"{d.mean * 1e3:.3f}\t{d.p99 * 1e3:.2f}\t{d.maximum * 1e3:.1f}\t"
                f"{1e3 * cd_paper(truth, points, longest):.3f}\t{1e3 * floor:.3f}\t{listed}\t"
                f"{sum(report.seconds.values()):.0f}"
            )
            click.echo(rows[-1])
            target.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
