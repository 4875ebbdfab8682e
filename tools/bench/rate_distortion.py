"""Error against bytes: our files and what users do today, in one run.

    python tools/bench/rate_distortion.py results/0.1 rocker-arm armadillo --budgets 1024,2048,4096

Writes <out>/points.tsv (a row a measured point, the store that makes the run resumable), <out>/ratios.tsv (per mesh
and budget: the best peer's CD, interpolated log-log on the lower envelope of its points, over ours; our p99, maximum
and normals over those of that envelope; geometric means), a plot per mesh, and our files in <out>/files. These go
through the command line tools; all errors are against the original mesh, normalised, in thousandths: CD, p99, maximum;
and the mean angle between normals at nearest points, in degrees. A mesh is a name of the corpus (CNDHF_CORPUS) or a
path.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import click
import matplotlib
import numpy as np
import trimesh

from cndhf_codec.mesh.read import read_mesh

matplotlib.use("Agg")
from matplotlib import pyplot as plt

sys.path.insert(0, str(Path(__file__).parent))
from measure import SAMPLES, Reference

COLUMNS = ("mesh", "method", "budget", "bytes", "CD", "p99", "max", "normals", "encode s", "decode s")
# Per surface, at some 400 points per mesh, then at those of them that are at most NEAR times the envelope: the CD is
# then good to half a per cent.
PEER_SAMPLES, NEAR_SAMPLES, NEAR = 8_000, 50_000, 1.03
ROOT = Path(__file__).parents[2]
CORPUS = Path(os.environ.get("CNDHF_CORPUS", ROOT.parent / "shared" / "corpus"))

Row = dict[str, str]
Mesh = tuple[np.ndarray, np.ndarray]


def mesh_path(name: str) -> Path:
    path = Path(name)
    return path if path.exists() else next(iter(sorted(CORPUS.glob(f"{name}.*"))), path)


def row(reference: Reference, out: Mesh, fields: dict[str, object], samples: int = SAMPLES) -> Row:
    figures = {**fields, **reference.figures(out, samples)}
    return {k: f"{v:.4g}" if isinstance(v, float) else str(v) for k, v in figures.items()}


def measure_peers(name: str) -> list[Row]:
    import peers

    mesh = read_mesh(mesh_path(name))
    reference = Reference(mesh)
    rows, outs = [], []
    for points in (peers.draco, peers.meshopt):
        for method, size, out, encode, decode in points(mesh.vertices, mesh.faces):
            fields = {"mesh": name, "method": method, "budget": "-", "bytes": size}
            rows.append(row(reference, out, {**fields, "encode s": encode, "decode s": decode}, PEER_SAMPLES))
            outs.append(out)
    kept = []
    sizes, errors = envelope(rows)
    for r, out in zip(rows, outs, strict=True):
        if float(r["CD"]) <= NEAR * float(np.exp(np.interp(np.log(int(r["bytes"])), np.log(sizes), np.log(errors)))):
            kept.append({**r, **row(reference, out, {}, NEAR_SAMPLES)})
    return kept


def measure_ours(name: str, method: str, budget: int, threads: int, files: Path) -> list[Row]:
    """method: "cndhf", the preset and the representation."""
    preset, representation = method.split()[1:]
    mesh = read_mesh(mesh_path(name))
    with tempfile.TemporaryDirectory() as folder:
        coded, back = (
            files / f"{mesh_path(name).stem}-{'-'.join(method.split()[1:])}-{budget}.cndhf",
            Path(folder) / "x.ply",
        )
        encode = ["cndhf-encode", str(mesh_path(name)), str(coded), "--quiet", "--overwrite", "--preset", preset]
        decode = ["cndhf-decode", str(coded), str(back), "--quiet"]
        encode += ["--representation", representation]
        if representation == "dhf":
            decode += ["--resolution", "384"]
        start = time.perf_counter()
        subprocess.run([*encode, "--target-size", str(budget), "--threads", str(threads)], check=True)
        middle = time.perf_counter()
        subprocess.run(decode, check=True)
        end = time.perf_counter()
        surface = trimesh.load(back, process=False)
        out = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces, dtype=np.int64)
        fields = {"mesh": name, "method": method, "budget": budget, "bytes": coded.stat().st_size}
        return [row(Reference(mesh), out, {**fields, "encode s": middle - start, "decode s": end - middle})]


def load_rows(path: Path) -> list[Row]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def save_rows(path: Path, rows: list[Row], columns: tuple[str, ...]) -> None:
    text = "\n".join("\t".join(r[c] for c in columns) for r in [dict(zip(columns, columns, strict=True)), *rows])
    path.write_text(text + "\n", encoding="utf-8")


def envelope(rows: list[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Bytes and CD of the points that no point of fewer bytes beats."""
    points = sorted((int(r["bytes"]), float(r["CD"])) for r in rows)
    best: list[tuple[int, float]] = []
    for size, cd in points:
        if not best or cd < best[-1][1]:
            best.append((size, cd))
    return np.array([p[0] for p in best], dtype=float), np.array([p[1] for p in best])


def at_envelope(peers: list[Row], size: float, column: str) -> float:
    """A column of the peers' envelope at a size, NaN below its first point, interpolated log-log."""
    sizes, errors = envelope(peers)
    if size < sizes[0]:
        return float("nan")
    # Beyond the last point a peer has nothing better to offer: its error there is what counts.
    on = {(int(r["bytes"]), float(r["CD"])): float(r[column]) for r in peers}
    values = np.array([on[int(s), e] for s, e in zip(sizes, errors, strict=True)])
    return float(np.exp(np.interp(np.log(size), np.log(sizes), np.log(np.maximum(values, 1e-6)))))


RATIOS = ("ratio to the best peer", "p99 / peer", "max / peer", "normals / peer")


def write_ratios(out: Path, rows: list[Row]) -> None:
    head = ("mesh", "method", "budget", "bytes", "CD", "p99", "max", "normals", *RATIOS, "encode s", "decode s")
    lines = ["\t".join(head)]
    groups: dict[tuple[str, str], list[list[float]]] = {}
    for r in sorted((r for r in rows if r["method"].startswith("cndhf")), key=lambda r: (int(r["budget"]), r["mesh"])):
        peers = [p for p in rows if p["mesh"] == r["mesh"] and not p["method"].startswith("cndhf")]
        if not peers:
            continue
        size = float(r["bytes"])
        ratios = [at_envelope(peers, size, "CD") / float(r["CD"])]
        ratios += [float(r[c]) / at_envelope(peers, size, c) for c in ("p99", "max", "normals")]
        groups.setdefault((r["method"], r["budget"]), []).append(ratios)
        cells = [*(r[k] for k in head[:8]), *(f"{x:.2f}" for x in ratios), r["encode s"], r["decode s"]]
        lines.append("\t".join(cells))
    for (method, budget), of_group in groups.items():
        known = np.array([x for x in of_group if np.isfinite(x).all()])
        if len(known):
            means = np.exp(np.log(np.maximum(known, 1e-6)).mean(axis=0))
            cells = [f"{means[0]:.2f} (least {known[:, 0].min():.2f})", *(f"{m:.2f}" for m in means[1:])]
            lines.append("\t".join([f"geometric mean of {len(known)}", method, budget, *[""] * 5, *cells, "", ""]))
    (out / "ratios.tsv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def plot(out: Path, name: str, rows: list[Row]) -> None:
    figure, axis = plt.subplots(figsize=(5, 4))
    of_mesh = [r for r in rows if r["mesh"] == name]
    for start in ("draco", "meshopt"):
        peers = [r for r in of_mesh if r["method"].startswith(start)]
        if peers:
            axis.loglog(*envelope(peers), label=start, marker=".")
    for method in sorted({r["method"] for r in of_mesh if r["method"].startswith("cndhf")}):
        ours = sorted((int(r["bytes"]), float(r["CD"])) for r in of_mesh if r["method"] == method)
        axis.loglog(*zip(*ours, strict=True), label=method, marker="o")
    axis.set(xlabel="bytes", ylabel="CD x 1000", title=name)
    axis.grid(True, which="both", alpha=0.3)
    axis.legend()
    figure.tight_layout()
    figure.savefig(out / f"{name}.png", dpi=100)
    plt.close(figure)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--budgets", default="1024,2048,4096,8192,16384", show_default=True, help="Bytes.")
@click.option("--preset", default="default", show_default=True)
@click.option("--representation", type=click.Choice(["auto", "dhf", "surface"]), default="auto", show_default=True)
@click.option("--jobs", default=1, show_default=True, help="Points computed at a time.")
def main(out: Path, names: tuple[str, ...], budgets: str, preset: str, representation: str, jobs: int) -> None:
    from tqdm import tqdm  # here, for tests read the rest without it

    method = f"cndhf {preset} {representation}"
    files = out / "files"
    files.mkdir(parents=True, exist_ok=True)
    store = out / "points.tsv"
    rows = load_rows(store)
    have = {(r["mesh"], r["method"], r["budget"]) for r in rows}
    with_peers = {r["mesh"] for r in rows if not r["method"].startswith("cndhf")}
    threads = max(1, (os.cpu_count() or 1) // jobs)
    with ProcessPoolExecutor(jobs) as pool:
        work = [pool.submit(measure_peers, n) for n in names if n not in with_peers]
        for budget in (int(b) for b in budgets.split(",")):
            for name in names:
                if (name, method, str(budget)) not in have:
                    work.append(pool.submit(measure_ours, name, method, budget, threads, files))
        failed = []
        for done in tqdm(as_completed(work), total=len(work), unit="point"):
            error = done.exception()
            if error is not None:
                failed.append(str(error))
                continue
            rows += done.result()
            save_rows(store, rows, COLUMNS)
            write_ratios(out, rows)
    for name in names:
        plot(out, name, rows)
    for message in failed:
        click.echo(f"failed: {message}", err=True)
    if rows:
        write_ratios(out, rows)
        click.echo((out / "ratios.tsv").read_text(encoding="utf-8"))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
