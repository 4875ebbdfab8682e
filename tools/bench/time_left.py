"""How well an encode tells the time that it still takes.

    python tools/bench/time_left.py OUT.tsv MESHES [--preset fast,default] [--representation surface] [--size 2KiB]

MESHES are names of the corpus (CNDHF_CORPUS). A row for each: the whole time, and at a quarter, half and three quarters
of it the time left that the progress bar shows over the true one; `-` where it shows none. Times are those of the
processor, of one thread, so that other work on the machine does not disturb. What is compiled is left out, as the bar
leaves it out. OUT.json, beside it, has the steps of each encode, for the tests.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import click
from rate_distortion import mesh_path

import cndhf_codec
from cndhf_codec.encoder.progress import Estimate

QUARTERS = (0.25, 0.5, 0.75)
Step = tuple[float, str, int, int]  # seconds since the start, stage, done, total


def steps_of(name: str, preset: str, representation: str, size: str) -> list[Step]:
    """The progress of an encode, and a last step of no stage where it ends."""
    steps: list[Step] = []
    compiled, since = 0.0, 0.0

    def progress(stage: str, done: int, total: int, loss: float = math.nan) -> None:
        nonlocal compiled, since
        now = time.process_time()
        if stage != "compile":
            steps.append((now - compiled, stage, done, total))
        elif done:
            compiled += now - since
        else:
            since = now

    warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
    cndhf_codec.encode(
        mesh_path(name), preset=preset, representation=representation, target_size=size, threads=1, progress=progress
    )
    progress("", 1, 1)
    first = steps[0][0]
    return [(round(at - first, 3), stage, done, total) for at, stage, done, total in steps]


def thinned(steps: list[Step]) -> list[Step]:
    """Those between which a hundredth of the time passes, or the stage changes."""
    out = steps[:1]
    for step, after in zip(steps[1:], [*steps[2:], None], strict=True):
        if after is None or after[1] != step[1] or step[1] != out[-1][1] or step[0] - out[-1][0] > 0.01 * steps[-1][0]:
            out.append(step)
    return out


def told(steps: list[Step], share: float) -> float:
    """The time left that is shown when that share of an encode has passed, over the true one; NaN: none is shown."""
    whole = steps[-1][0]
    now = share * whole
    estimate = Estimate(0.0)
    for at, stage, done, total in steps[:-1]:
        if at > now:
            break
        estimate.update(stage, done, total, at)
    left = estimate.left(now)
    return math.nan if left is None else left / (whole - now)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--preset", default="fast,default")
@click.option("--representation", default="surface")
@click.option("--size", default="2KiB")
def main(out: Path, names: tuple[str, ...], preset: str, representation: str, size: str) -> None:
    """Add rows to a table."""
    if not out.exists():
        out.write_text("mesh\tpreset\trepresentation\tsize\tseconds\tquarter\thalf\tthree quarters\n", "utf-8")
    kept = out.with_suffix(".json")
    known = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
    for name in names:
        for one in preset.split(","):
            # A new process each, as a command is: compiled code is loaded again.
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                steps = pool.submit(steps_of, name, one, representation, size).result()
            cells = [f"{told(steps, q):.2f}".replace("nan", "-") for q in QUARTERS]
            row = "\t".join([name, one, representation, size, f"{steps[-1][0]:.1f}", *cells])
            print(row, flush=True)
            with out.open("a", encoding="utf-8") as lines:
                lines.write(row + "\n")
            known[f"{name} {one} {representation} {size}"] = thinned(steps)
            kept.write_text(json.dumps(known) + "\n", "utf-8")


if __name__ == "__main__":
    main()
