"""What time limits do: the time taken, and the error.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python tools/bench/time_limits.py OUT.tsv MESHES [--limits 10,20,40,120]

MESHES are names of the corpus (CNDHF_CORPUS), encoded to 2 KiB by preset `default` as surfaces, in a process each.
Limits and times are those of the processor, of one thread, so that other work on the machine does not disturb. `-`: it
failed, with the line that is printed. Encode once before: compiling counts here.
"""

from __future__ import annotations

import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import click
from rate_distortion import mesh_path

import cndhf_codec
from cndhf_codec.encoder.compiling import Compiling


def limited(name: str, limit: float) -> str:
    """The seconds taken, and the mean error and maximum in percent of the diagonal, or the line of the failure."""
    warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
    Compiling.now = lambda self: time.process_time()  # type: ignore[method-assign]
    start = time.process_time()
    try:
        report = cndhf_codec.encode(
            mesh_path(name), target_size="2KiB", representation="surface", threads=1, time_limit=limit
        ).report
    except cndhf_codec.EncodeError as exc:
        return f"{time.process_time() - start:.1f}\t-\t{exc}"
    assert report.distances is not None
    mean, most = (100 * d / report.diagonal for d in (report.distances.mean, report.distances.maximum))
    return f"{time.process_time() - start:.1f}\t{mean:.4f}\t{most:.3f}"


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--limits", default="10,20,40,120")
def main(out: Path, names: tuple[str, ...], limits: str) -> None:
    """Write a table."""
    with out.open("w", encoding="utf-8") as lines:
        lines.write("mesh\tlimit\tseconds\tmean\tmaximum\n")
        for name in names:
            for limit in limits.split(","):
                with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                    row = f"{name}\t{limit}\t{pool.submit(limited, name, float(limit)).result()}"
                print(row, flush=True)
                lines.write(row + "\n")
                lines.flush()


if __name__ == "__main__":
    main()
