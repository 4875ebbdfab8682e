"""What a batch costs per file, by stage, and what its one coordinating process can do: the figures of docs/scaling.md.

    python tools/bench/batch_stages.py [--files 12] [--rows 5000]

Encodes some files of `batch_throughput.py` in this process, and prints the processor seconds of each stage. Then runs
the coordination of a batch with workers that do nothing: listing, manifest, and what is skipped on a second run; and
Ray's tasks that do nothing.
"""

from __future__ import annotations

import math
import os
import statistics
import tempfile
import time
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import psutil
from batch_throughput import make_files

from cndhf_codec import CndhfWarning, encode
from cndhf_codec.batch.discovery import find
from cndhf_codec.batch.jobs import Job, Result
from cndhf_codec.batch.run import Order, run
from cndhf_codec.decoder.parallel import limit_threads


def stages(files: list[Path], preset: str) -> dict[str, list[float]]:
    """Processor seconds of each file, by stage. The first file is encoded twice: it loads what is compiled."""
    found: dict[str, list[float]] = defaultdict(list)
    for k, file in enumerate([files[0], *files]):
        spent: dict[str, float] = defaultdict(float)
        last = ["", time.process_time()]

        def progress(stage: str, done: int, total: int, loss: float = math.nan, spent=spent, last=last) -> None:
            now = time.process_time()
            if last[0]:
                spent[last[0]] += now - last[1]
            last[:] = [stage, now]

        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CndhfWarning)
            encode(file, preset=preset, threads=1, progress=progress)
        whole = time.process_time() - start
        if k:
            for stage, seconds in spent.items():
                found[stage].append(seconds)
            found["whole"].append(whole)
    return found


class Idle:
    """Workers that have done everything at once."""

    def results(self, jobs: Iterator[Job]) -> Iterator[Result]:
        for job in jobs:
            if job.target is not None:
                Path(job.target).write_bytes(b"x" * 100)
            yield Result(job.name, "done", bytes=100, hash="0" * 64, diagonal=1.0, seconds=1.0)

    def close(self) -> None:
        pass


class Deaf:
    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def coordination(rows: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "in"
        for k in range(rows):
            path = source / f"{k // 500}" / f"{k}.obj"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"x")
            os.utime(path, (1e9, 1e9))
            (Path(folder) / "out" / f"{k // 500}").mkdir(parents=True, exist_ok=True)
        start = time.perf_counter()
        find(str(source))
        print(f"listing\t{rows / (time.perf_counter() - start):.0f} files per second")
        order = Order(str(source), str(Path(folder) / "out"))
        for what in ("handed out and recorded", "skipped"):
            start = time.perf_counter()
            run(order, Idle(), Deaf())
            print(f"{what}\t{rows / (time.perf_counter() - start):.0f} files per second")
        size = (Path(folder) / "out" / "cndhf-batch.sqlite").stat().st_size
        print(f"manifest\t{size / rows:.0f} bytes per file")


def tasks(count: int) -> None:
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    nothing = ray.remote(max_retries=3)(lambda job: job)
    ray.get([nothing.remote(0) for _ in range(100)])
    start = time.perf_counter()
    pending = [nothing.remote("x" * 500) for _ in range(8)]
    for _ in range(count):
        (ready,), pending = ray.wait(pending, num_returns=1)
        ray.get(ready)
        pending.append(nothing.remote("x" * 500))
    print(f"Ray tasks\t{count / (time.perf_counter() - start):.0f} per second")
    ray.shutdown()


@click.command()
@click.option("--files", default=12, show_default=True)
@click.option("--preset", default="fast", show_default=True)
@click.option("--rows", default=5000, show_default=True)
def main(files: int, preset: str, rows: int) -> None:
    """Measure, and print lines separated by tabs."""
    limit_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        made = make_files(Path(folder), files)
        found = stages(made, preset)
        size = sum(p.stat().st_size for p in made) / len(made)
    print(f"input\t{size / 1e6:.2f} MB per file")
    for stage, seconds in found.items():
        print(f"{stage}\t{statistics.mean(seconds):.2f} s per file ({min(seconds):.2f} to {max(seconds):.2f})")
    memory = psutil.Process().memory_info()
    print(f"memory\t{memory.rss / 1e6:.0f} MB now")
    coordination(rows)
    tasks(2000)


if __name__ == "__main__":
    main()
