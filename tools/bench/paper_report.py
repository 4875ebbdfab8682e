"""The tables and figures of paper_tables.py, from its points."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import matplotlib
import numpy as np
from rate_distortion import ROOT, Row, at_envelope, envelope, load_rows, mesh_path, save_rows

from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid
from cndhf_codec.report.render import picture, view_frame

sys.path.insert(0, str(Path(__file__).parents[1]))
from paper_table import NAMES, printed

matplotlib.use("Agg")
from matplotlib import pyplot as plt

RIVALS = ("siren_sdf", "nglod", "vqad", "idf")
METHODS = (*RIVALS, "paper", "dhf", "surface")
KEY = ("mesh", "method", "level", "seed")
COLUMNS = (
    *(*KEY, "parameters", "bytes", "fields", "steps", "seconds", "CD", "p99", "max", "normals", "CD-paper"),
    *("CD of bytes", "normals of bytes"),
)
MEANS = ("CD", "p99", "normals", "CD-paper")
PRINTED = {"siren_sdf": "siren", "nglod": "nglod", "vqad": "vqad", "paper": "cndhf"}  # as paper-figures.tsv has them
# What is measured elsewhere in this repository: by the start of a method's name, the folders of its points.
OTHERS = {
    "dhf": ("cndhf default", ("0.1", "0.1/mechanical")),
    "surface": ("cndhf default surface", ("0.2", "0.2/mechanical")),
    "peers": (("draco", "meshopt"), ("0.2", "0.2/mechanical")),
}
LABELS = {"dhf": "dhf, default", "surface": "surface, default", "peers": "Draco, meshopt"}
MOST_BYTES = 16_384  # of those in the figure
PARAMETERS = (5000, 10_000, 20_000, 40_000)  # about those of the levels
ROWS_OF_PICTURES = 4

Cells = dict[tuple[str, str], dict[str, Row]]


def report(out: Path, rows: list[Row], figures: Path) -> None:
    """Write all that can be made of the rows that are there."""
    if not rows:
        return
    cells = means(rows)
    parameters = by_parameters(cells, figures)
    save_rows(out / "parameters.tsv", parameters, tuple(parameters[0]))
    claims = claims_of(cells)
    if claims:
        save_rows(out / "claims.tsv", claims, tuple(claims[0]))
        print((out / "claims.tsv").read_text(encoding="utf-8"))
    others = {name: known_points(*what) for name, what in OTHERS.items()}
    sizes = by_bytes(rows, others)
    if sizes:
        save_rows(out / "bytes.tsv", sizes, tuple(sizes[0]))
    plots(out, rows, others)
    renders(out)


def means(rows: list[Row]) -> Cells:
    """Per mesh and level, per method: the mean over seeds of the errors."""
    groups: dict[tuple[str, str], dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for r in rows:
        groups[r["mesh"], r["level"]][r["method"]].append(r)
    return {
        key: {
            method: {**some[0], **{c: f"{np.mean([float(r[c]) for r in some]):.4g}" for c in MEANS}}
            for method, some in of.items()
        }
        for key, of in groups.items()
    }


def by_parameters(cells: Cells, figures: Path) -> list[Row]:
    """A row per mesh, level and method, with the paper's figure and its parameters beside ours."""
    known = {m: printed(figures, column) for m, column in PRINTED.items()} if figures.exists() else {}
    out = []
    for (mesh, level), of in sorted(cells.items(), key=lambda item: (item[0][1], item[0][0])):
        for method in (m for m in METHODS[:-1] if m in of):
            r = of[method]
            figure = known.get(method, {}).get((NAMES.get(mesh, mesh), int(level)))
            out.append(
                {
                    **{k: r[k] for k in ("mesh", "level", "method", "parameters", "seconds", "CD", "p99", "normals")},
                    "CD-paper": r["CD-paper"],
                    "printed parameters": str(figure[0]) if figure else "-",
                    "printed": str(figure[1]) if figure else "-",
                }
            )
    return out


def claims_of(cells: Cells) -> list[Row]:
    """Of `paper` and of `dhf`, per level: the share of rivals' cells that have more error, and how much more the best
    rival of a mesh has (geometric mean)."""
    out = []
    for level in sorted({level for _, level in cells}):
        for ours in ("paper", "dhf"):
            for column in ("CD", "CD-paper", "normals"):
                row = {"level": level, "method": ours, "figure": column}
                best: list[float] = []
                for rival in (*RIVALS, "all"):
                    pairs = [
                        (float(of[ours][column]), float(of[r][column]))
                        for (_, at), of in cells.items()
                        for r in (RIVALS if rival == "all" else (rival,))
                        if at == level and ours in of and r in of
                    ]
                    row[f"under {rival}"] = f"{sum(a < b for a, b in pairs)} of {len(pairs)}"
                for (_, at), of in cells.items():
                    some = [float(of[r][column]) for r in RIVALS if r in of]
                    if at == level and ours in of and some:
                        best.append(min(some) / float(of[ours][column]))
                row["best rival over it"] = f"{np.exp(np.mean(np.log(best))):.3f}" if best else "-"
                out.append(row)
    return out


def known_points(start: str | tuple[str, ...], folders: tuple[str, ...]) -> list[Row]:
    rows = [r for folder in folders for r in load_rows(ROOT / "results" / folder / "points.tsv")]
    return [r for r in rows if r["method"].startswith(start)]


def by_bytes(rows: list[Row], others: dict[str, list[Row]]) -> list[Row]:
    """A row per point: its bytes and error, and those of `default` height fields and surfaces and of today's tools at
    the same bytes, interpolated on their envelopes."""
    out = []
    for r in rows:
        row = {**{k: r[k] for k in KEY}, "bytes": r["bytes"], "CD": r["CD of bytes"], "normals": r["normals of bytes"]}
        for name, of_all in others.items():
            some = [o for o in of_all if o["mesh"] == r["mesh"]]
            at = at_envelope(some, float(r["bytes"]), "CD") if some else float("nan")
            row |= {f"{name} CD": f"{at:.4g}", f"over {name}": f"{float(r['CD of bytes']) / at:.3g}"}
        out.append(row)
    return out


def plots(out: Path, rows: list[Row], others: dict[str, list[Row]]) -> None:
    """Error against parameters, and against bytes, a panel per mesh."""
    names = list(dict.fromkeys(r["mesh"] for r in rows))
    for file, across, up in (("parameters", "parameters", "CD"), ("bytes", "bytes", "CD of bytes")):
        columns = min(4, len(names))
        lines = -(-len(names) // columns)
        figure, axes = plt.subplots(lines, columns, figsize=(3.1 * columns, 2.8 * lines), squeeze=False)
        for axis in axes.flat[len(names) :]:
            axis.axis("off")
        for axis, name in zip(axes.flat, names, strict=False):
            for k, method in enumerate(METHODS if across == "bytes" else METHODS[:-1]):
                points = sorted(
                    (float(r[across]), float(r[up])) for r in rows if (r["mesh"], r["method"]) == (name, method)
                )
                if points:
                    axis.loglog(*zip(*points, strict=True), label=method, marker="o", ms=3, lw=1, color=f"C{k}")
            if across == "bytes":
                for (start, of_all), style in zip(others.items(), ("k--", "k:", "grey"), strict=True):
                    some = [o for o in of_all if o["mesh"] == name and int(o["bytes"]) <= MOST_BYTES]
                    if some:
                        axis.loglog(*envelope(some), style, label=LABELS[start], lw=1)
            axis.set_title(name, fontsize=9)
            axis.grid(True, which="both", alpha=0.3)
            if across == "parameters":
                axis.set_xlim(PARAMETERS[0] / 2, 2 * PARAMETERS[-1])
                axis.set_xticks(PARAMETERS, [str(x) for x in PARAMETERS])
                axis.xaxis.set_minor_formatter("")
            axis.tick_params(labelsize=7, which="both")
        figure.supxlabel(across, fontsize=9)
        figure.supylabel("CD x 1000", fontsize=9)
        found = {label: line for a in axes.flat for line, label in zip(*a.get_legend_handles_labels(), strict=True)}
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.3 / (2.8 * lines)))
        figure.legend(found.values(), found.keys(), loc="upper center", ncols=len(found), fontsize=7, frameon=False)
        figure.savefig(out / f"{file}.png", dpi=80)
        plt.close(figure)


def renders(out: Path) -> None:
    """The meshes of level 1 in out/files, a row per input."""
    files = {tuple(p.stem.rsplit("+", 1)): p for p in (out / "files").glob("*.ply")}
    names = sorted({name for name, _ in files})[:ROWS_OF_PICTURES]
    if not names:
        return
    columns = [None, *METHODS]
    figure, axes = plt.subplots(
        len(names), len(columns), figsize=(1.6 * len(columns), 1.75 * len(names)), squeeze=False
    )
    frame = view_frame(35, 25)
    for line, name in zip(axes, names, strict=True):
        norm = normalisation(read_mesh(mesh_path(name)))
        for axis, method in zip(line, columns, strict=True):
            axis.axis("off")
            path = mesh_path(name) if method is None else files.get((name, method))
            if path is None:
                continue
            mesh = read_mesh(path)
            axis.imshow(picture(Solid(norm.apply(mesh.vertices), mesh.faces), frame, 256))
            axis.set_title(method or name, fontsize=7, pad=1)
    figure.tight_layout(pad=0.2)
    figure.savefig(out / "renders.png", dpi=100)
    plt.close(figure)
