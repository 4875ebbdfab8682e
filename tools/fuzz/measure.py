"""Time and memory that reading a file takes: `python tools/fuzz/measure.py FILES...` prints the worst of each.

Without the fuzzer's instrumentation, which makes Python several times slower. With `--surfaces`, the limits are those
of files that hold one. With `--meshes`, FILES are inputs of `meshes.py`: a byte that chooses the kind, and a mesh.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mesh_target

from cndhf_codec import loads
from cndhf_codec.errors import FormatError

LARGEST = 2**16  # bytes of a file for which the limits hold


def attempt(data: bytes) -> bool:
    """Whether the file was accepted. Raises nothing but what is a finding."""
    try:
        loads(data)
    except FormatError:
        return False
    return True


def attempt_mesh(data: bytes) -> bool:
    try:
        mesh_target.read(data)
    except mesh_target.ALLOWED:
        return False
    return True


@dataclass(frozen=True)
class Subject:
    """What is read, and the most that it may cost."""

    name: str
    attempt: Callable[[bytes], bool]
    most_seconds: float
    most_bytes: int


SUBJECTS = {
    s.name: s
    for s in (
        Subject("cndhf", attempt, 0.1, 2**26),
        # Up to 2^18 faces, each read in pure Python.
        Subject("surfaces", attempt, 5.0, 2**28),
        Subject("meshes", attempt_mesh, 1.0, 2**28),
    )
}


def seconds(data: bytes, attempt: Callable[[bytes], bool], tries: int = 3) -> float:
    """Processor time, the least of some tries: a busy machine is no finding."""
    best = float("inf")
    for _ in range(tries):
        begin = time.thread_time()
        attempt(data)
        best = min(best, time.thread_time() - begin)
    return best


class Peak:
    """Most resident memory since `reset` beyond what there was then, in bytes (Linux)."""

    def __init__(self) -> None:
        self.status = os.open("/proc/self/status", os.O_RDONLY)
        self.clear = os.open("/proc/self/clear_refs", os.O_WRONLY)

    def reset(self) -> None:
        os.pwrite(self.clear, b"5", 0)  # the high-water mark is now what is resident
        self.before = self._high_water()

    def grown(self) -> int:
        return self._high_water() - self.before

    def _high_water(self) -> int:
        found = re.search(rb"VmHWM:\s*(\d+)", os.pread(self.status, 4096, 0))
        assert found
        return 1024 * int(found[1])


def peak(data: bytes, attempt: Callable[[bytes], bool]) -> int:
    memory = Peak()
    memory.reset()
    attempt(data)
    return memory.grown()


def main() -> None:
    names = [name for name in sys.argv[1:] if not name.startswith("--")]
    subject = next((s for s in SUBJECTS.values() if f"--{s.name}" in sys.argv), SUBJECTS["cndhf"])
    rows = []
    for name in names:
        path = Path(name)
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            data = file.read_bytes()
            if len(data) < LARGEST:
                most = peak(data, subject.attempt)  # first: what a second try finds in caches counts too
                rows.append((seconds(data, subject.attempt), most, len(data), file.name))
    slowest, largest = max(rows), max(rows, key=lambda row: row[1])
    print(f"{len(rows)} files")
    print(f"slowest: {1000 * slowest[0]:.1f} ms, {slowest[2]} bytes, {slowest[3]}")
    print(f"most memory: {largest[1] / 2**20:.1f} MiB, {largest[2]} bytes, {largest[3]}")
    if slowest[0] > subject.most_seconds or largest[1] > subject.most_bytes:
        sys.exit(1)


if __name__ == "__main__":
    main()
