"""What is asked for each file, and what came of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

File = bytes
Outcome = Literal["done", "failed", "crashed", "memory", "timeout", "refused"]
OUTCOMES: dict[str, str] = {
    "done": "encoded",
    "failed": "failed",
    "crashed": "crashed",
    "memory": "over --memory",
    "timeout": "over --timeout",
    "refused": "no regular file",
}


@dataclass(frozen=True)
class Job:
    """One file to encode.

    name: of the input, in messages and in the manifest. source: path or URL to read. target: path or URL to write, or
    None where the bytes themselves are the result. options: those of `encode`. known: hash of a content that need not
    be encoded again, or "". version: of the package that asks, which has to be the one that encodes.
    """

    name: str
    source: str
    target: str | None
    options: Mapping[str, Any]
    version: str
    known: str = ""


@dataclass(frozen=True)
class Result:
    """What became of one file.

    Attributes
    ----------
    input : str
        Its path, as it was given or below IN.
    output : str
        Path or URL of the `.cndhf` file, below OUT where the input is below IN; "" where there is none.
    outcome : {"done", "failed", "crashed", "memory", "timeout", "refused"}
        "crashed": the mesh ended its process. "memory", "timeout": it went over the limit. "refused": no regular file.
    reason : str
        One line where the outcome is not "done".
    source_bytes, bytes : int
        Sizes of the input and of the `.cndhf` file.
    representation : str
        "dhf" or "surface".
    mean_error, p99_error, max_error, diagonal : float
        Measured errors, and the diagonal of the input's bounding box; in input units.
    seconds : float
        That the file took.
    warnings : tuple of str
        A line for each thing that had to be assumed.
    hash : str
        SHA-256 of the input's content.
    fresh : bool
        False where an earlier run did the same, and nothing was done.
    data : bytes or None
        The `.cndhf` file, where no folder was named to write it to.
    """

    input: str
    outcome: Outcome
    output: str = ""
    reason: str = ""
    source_bytes: int = 0
    bytes: int = 0
    representation: str = ""
    mean_error: float = 0.0
    p99_error: float = 0.0
    max_error: float = 0.0
    diagonal: float = 0.0
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    hash: str = ""
    fresh: bool = True
    data: File | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Limits:
    """What one file may use: threads, bytes of memory, seconds; None is no limit."""

    threads: int = 1
    memory: int | None = None
    timeout: float | None = None


class Runner(Protocol):
    """Something that works through jobs."""

    def results(self, jobs: Iterator[Job]) -> Iterator[Result | None]:
        """Take jobs as there is room for them, and yield results as they end; None now and then while all work."""

    def close(self) -> None:
        """End what still runs."""
