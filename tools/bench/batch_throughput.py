"""How fast `cndhf-batch` is, and what it makes of being killed: `python tools/bench/batch_throughput.py`.

Makes up to 200 files of the corpus: its 40 meshes, and of each one that is turned, one that is scaled, and two with a
quarter and a sixteenth of the faces. Then

- encodes them with `cndhf-batch --jobs J`, and with J shells that each loop `cndhf-encode` over a part; compares the
  bytes;
- encodes them again with a `cndhf-batch` that is killed (SIGKILL) some times and run again, and compares the bytes;
- with --ray, encodes them with two Ray workers of a `ray start --head`, one of which is killed, and compares the bytes.

Prints a table, separated by tabs: wall-clock seconds, and those of the processors, which a busy machine changes less.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import click
import fast_simplification
import numpy as np
import psutil
import trimesh

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(os.environ.get("CNDHF_CORPUS", ROOT.parent / "shared" / "corpus"))
MESHES = (".ply", ".obj", ".off", ".stl", ".glb")
VARIANTS = ("as it is", "turned", "scaled", "quarter", "sixteenth")
FEWEST = 100  # faces of a decimated mesh


def make_files(folder: Path, count: int) -> list[Path]:
    """Write the first `count` files of the corpus and its variants, in an order that mixes them."""
    sources = sorted(p for p in CORPUS.iterdir() if p.suffix in MESHES)
    all_of_them = [(source, variant) for source in sources for variant in VARIANTS]
    random.Random(0).shuffle(all_of_them)
    made = []
    for source, variant in all_of_them[:count]:
        (folder / variant.replace(" ", "-")).mkdir(parents=True, exist_ok=True)
        target = folder / variant.replace(" ", "-") / f"{source.stem}.ply"
        if variant == "as it is":
            target = target.with_suffix(source.suffix)
            shutil.copy(source, target)
        else:
            _variant(source, variant).export(target)
        made.append(target)
    return sorted(made)


def _variant(source: Path, variant: str) -> trimesh.Trimesh:
    mesh = trimesh.load(source, force="mesh", process=False)
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    if variant == "turned":
        angles = np.random.default_rng(len(faces)).uniform(0, 2 * np.pi, 3)
        vertices = trimesh.transform_points(vertices, trimesh.transformations.euler_matrix(*angles))
    elif variant == "scaled":
        vertices = vertices * [2.0, 1.0, 0.5]
    else:
        vertices, faces = np.unique(vertices[faces].reshape(-1, 3), axis=0, return_inverse=True)
        faces = faces.reshape(-1, 3)
        wanted = max(len(faces) // (4 if variant == "quarter" else 16), FEWEST)
        if wanted < len(faces):
            vertices, faces = fast_simplification.simplify(vertices.astype(np.float32), faces, target_count=wanted)
    return trimesh.Trimesh(vertices.astype(np.float32), faces, process=False)


def command(name: str) -> list[str]:
    return [sys.executable, "-c", f"from cndhf_codec.cli import {name}; {name}()"]


class Clock:
    """Wall-clock seconds, and processor seconds of all processes that were started and have ended meanwhile."""

    def __enter__(self) -> Clock:
        self._wall, self._cpu = time.perf_counter(), _children()
        return self

    def __exit__(self, *_: object) -> None:
        self.wall, self.cpu = time.perf_counter() - self._wall, _children() - self._cpu


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def batch(source: Path, target: Path, options: Sequence[str], **more: object) -> subprocess.Popen[bytes]:
    arguments = [*command("batch"), str(source), str(target), *options, "--quiet"]
    return subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **more)  # type: ignore[call-overload,no-any-return]


def shells(files: Sequence[Path], source: Path, target: Path, jobs: int, options: Sequence[str]) -> None:
    """As many shells as jobs, each of which encodes its part, one file after another."""
    running = []
    for k in range(jobs):
        lines = []
        for file in files[k::jobs]:
            out = target / file.relative_to(source).with_suffix(".cndhf")
            out.parent.mkdir(parents=True, exist_ok=True)
            words = [*command("encode"), str(file), str(out), "--quiet", *options]
            lines.append(" ".join("'" + word.replace("'", "'\\''") + "'" for word in words))
        running.append(subprocess.Popen(["sh", "-c", "\n".join(lines)], stderr=subprocess.DEVNULL))
    for shell in running:
        shell.wait()


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*.cndhf"))}


def outcomes(folder: Path) -> str:
    with closing(sqlite3.connect(folder / "cndhf-batch.sqlite")) as base:
        found = base.execute("SELECT outcome, count(*) FROM files GROUP BY outcome ORDER BY outcome").fetchall()
    return ", ".join(f"{n} {outcome}" for outcome, n in found)


def killed(source: Path, target: Path, options: Sequence[str], kills: int, seconds: float) -> None:
    """Run, kill at a random moment, run again; the last run is left to end."""
    moments = random.Random(1)
    for _ in range(kills):
        process = batch(source, target, options)
        time.sleep(moments.uniform(0.1, 0.9) * seconds / (kills + 1))
        process.send_signal(signal.SIGKILL)
        process.wait()
    batch(source, target, options).wait()


def on_ray(source: Path, target: Path, options: Sequence[str]) -> None:
    """Two Ray workers of a cluster started here; one of them, with what it started, is killed in the middle."""
    ray = Path(sys.executable).with_name("ray")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    head = ["start", "--head", "--num-cpus=2", "--port=6399", "--include-dashboard=false", "--disable-usage-stats"]
    subprocess.run([ray, *head], check=True, **quiet)  # type: ignore[call-overload]
    try:
        process = batch(source, target, [*options, "--ray", "auto"])
        while not list(target.rglob("*.cndhf")) and process.poll() is None:
            time.sleep(0.2)
        victim = next(p for p in psutil.process_iter(["cmdline"]) if (p.info["cmdline"] or [""])[0] == "ray::_encode")
        os.kill(victim.pid, signal.SIGKILL)
        print(f"# killed the Ray worker {victim.pid}", file=sys.stderr)
        process.wait()
    finally:
        subprocess.run([ray, "stop"], check=False, **quiet)  # type: ignore[call-overload]


@click.command()
@click.option("--files", default=200, show_default=True, help="How many of the 200 files.")
@click.option("--jobs", default=2, show_default=True, help="Files at a time, and shells.")
@click.option("--preset", default="fast", show_default=True)
@click.option("--threads", type=int, help="Of each cndhf-encode in the shells.  [default: all, as of the command]")
@click.option("--kills", default=3, show_default=True, help="Times that a run is killed.")
@click.option("--ray/--no-ray", default=False, help="Also on Ray, with a worker killed.")
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this folder, and leave it there.")
def main(files: int, jobs: int, preset: str, threads: int | None, kills: int, ray: bool, keep: Path | None) -> None:
    """Measure, and print a table."""
    folder = keep or Path(tempfile.mkdtemp())
    source = folder / "in"
    made = make_files(source, files)
    options = ["--preset", preset]
    print("what\tfiles\twall_s\tcpu_s\tfiles_per_minute\toutcomes\tequal_bytes")

    def line(what: str, clock: Clock, target: Path, told: str) -> None:
        found = bytes_of(target)
        equal = "" if target == plain else str(found == bytes_of(plain))
        rate = f"{60 * len(found) / clock.wall:.2f}"
        print(f"{what}\t{len(made)}\t{clock.wall:.1f}\t{clock.cpu:.1f}\t{rate}\t{told}\t{equal}", flush=True)

    plain = folder / "batch"
    with Clock() as alone:
        batch(source, plain, [*options, "--jobs", str(jobs)]).wait()
    line(f"cndhf-batch --jobs {jobs}", alone, plain, outcomes(plain))

    with Clock() as clock:
        shells(made, source, folder / "shells", jobs, [*options, *(["--threads", str(threads)] if threads else [])])
    line(f"{jobs} shells of cndhf-encode", clock, folder / "shells", "")
    print(f"# shells over batch: wall {clock.wall / alone.wall:.3f}, cpu {clock.cpu / alone.cpu:.3f}", flush=True)

    if kills:
        with Clock() as clock:
            killed(source, folder / "killed", [*options, "--jobs", str(jobs)], kills, alone.wall)
        line(f"killed {kills} times", clock, folder / "killed", outcomes(folder / "killed"))
    if ray:
        with Clock() as clock:
            on_ray(source, folder / "ray", options)
        line("two Ray workers, one killed", clock, folder / "ray", outcomes(folder / "ray"))
    if keep is None:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
