"""A dataset of meshes in a pipeline of Ray Data: read files, encode them, write Parquet.

    python examples/ray_data.py MESHES DATASET [--preset fast] [--address ADDRESS] [--processes N]

MESHES is a folder or a URL of one (s3://, gs://). DATASET gets Parquet files with a row per mesh: its path, the
`.cndhf` file as bytes, its mean error in percent of the diagonal, its representation, and the reason where there is no
file. Ray reads ahead of the encoders and writes behind them, on as many machines as the cluster has. For meshes that
might crash their process or fill the memory, use `cndhf-batch --ray`, which names them and goes on.
"""

from __future__ import annotations

import argparse
import io
import warnings
from typing import Any

import pyarrow.dataset
import ray

import cndhf_codec

EXTENSIONS = ["obj", "ply", "stl", "off", "glb", "3mf"]


class Encoder:
    """Encodes one mesh after another in its process, with the imports and compiled code of the first."""

    def __init__(self, preset: str) -> None:
        self._preset = preset

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        out = {"path": row["path"], "cndhf": b"", "mean_percent": float("nan"), "representation": "", "reason": ""}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", cndhf_codec.CndhfWarning)
                model = cndhf_codec.encode(io.BytesIO(row["bytes"]), preset=self._preset, threads=1)
        except cndhf_codec.CndhfError as exc:
            return {**out, "reason": str(exc)}
        report = model.report
        error = 100 * report.distances.mean / report.diagonal
        return {**out, "cndhf": model.dumps(), "mean_percent": error, "representation": model.representation}


def build(meshes: str, dataset: str, preset: str = "default", processes: int | None = None) -> None:
    """Encode all meshes of a folder to a dataset.

    processes: how many encode at a time; by default all of the cluster's processors but one, which reads and writes.
    """
    count = processes or max(int(ray.cluster_resources()["CPU"]) - 1, 1)
    found = ray.data.read_binary_files(meshes, include_paths=True, file_extensions=EXTENSIONS)
    encoded = found.map(
        Encoder, fn_constructor_args=[preset], compute=ray.data.ActorPoolStrategy(size=count), num_cpus=1
    )
    encoded.write_parquet(dataset)


def main() -> None:
    parser = argparse.ArgumentParser(usage="python examples/ray_data.py MESHES DATASET [--preset P] [--address A]")
    parser.add_argument("meshes")
    parser.add_argument("dataset")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--address", help="of a Ray cluster; by default one is started on this machine")
    parser.add_argument("--processes", type=int)
    arguments = parser.parse_args()
    ray.init(address=arguments.address, log_to_driver=False)
    build(arguments.meshes, arguments.dataset, arguments.preset, arguments.processes)
    rows = pyarrow.dataset.dataset(arguments.dataset).to_table(columns=["path", "reason"]).to_pylist()
    failed = [row for row in rows if row["reason"]]
    for row in failed:
        print(f"{row['path']}: {row['reason']}")
    print(f"{len(rows)} meshes, {len(failed)} of them not encoded")


if __name__ == "__main__":
    main()
