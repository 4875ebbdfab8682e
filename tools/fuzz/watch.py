"""What the two fuzzers share: what each execution costs, the worst of them so far, and the run."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import measure


class FindingError(Exception):
    """What a reader must not do."""


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]  # not a CRC-32, which is the same for all that end in their own


class Watch:
    """slowest: instrumented seconds; from there on, each new record is timed without instruments."""

    def __init__(self, subject: measure.Subject, slowest: float) -> None:
        self.subject = subject
        self.started = time.monotonic()
        self.executions = self.accepted = self.most = 0
        self.slowest = slowest
        self.memory = measure.Peak()

    def begin(self) -> None:
        self.memory.reset()
        self.at = time.thread_time()

    def end(self, accepted: bool, data: bytes) -> None:
        seconds, grown = time.thread_time() - self.at, self.memory.grown()
        self.executions += 1
        self.accepted += accepted
        if len(data) < measure.LARGEST:
            self.most = max(self.most, grown)
            if grown > self.subject.most_bytes:
                raise FindingError(f"{grown} bytes of memory")
            if seconds > 1.1 * self.slowest:
                self.slowest = seconds
                self._time_without_instruments(data)
        if self.executions % 10_000 == 0:
            rate = self.executions / (time.monotonic() - self.started)
            print(
                f"watch: {self.executions} executions, {rate:.0f} a second, {self.accepted} accepted, slowest "
                f"{1000 * self.slowest:.0f} ms (instrumented), most memory {self.most / 2**20:.1f} MiB",
                file=sys.stderr,
                flush=True,
            )

    def _time_without_instruments(self, data: bytes) -> None:
        path = Path(f"slowest-{digest(data)}.{self.subject.name}")
        path.write_bytes(data)
        command = [sys.executable, str(Path(__file__).parent / "measure.py"), f"--{self.subject.name}", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        print(f"watch: slowest so far: {done.stdout.splitlines()[1:]}", file=sys.stderr, flush=True)
        if done.returncode:
            raise FindingError(f"too slow or too large: {done.stdout} {done.stderr}")
        path.unlink()


def run(
    seeds: Sequence[bytes], one_input: Callable[[bytes], None], custom_mutator: Callable[[bytes, int, int], bytes]
) -> None:
    """Puts the seeds into the corpus that the command line names, and lets libFuzzer go on from there."""
    import atheris  # here, for surfaces.py does without

    warnings.simplefilter("error")
    corpus = [a for a in sys.argv[1:] if not a.startswith("-")]
    if corpus:
        Path(corpus[0]).mkdir(parents=True, exist_ok=True)
        for seed in seeds:
            (Path(corpus[0]) / f"seed-{digest(seed)}").write_bytes(seed)
    atheris.Setup(sys.argv, one_input, custom_mutator=custom_mutator)
    atheris.Fuzz()
