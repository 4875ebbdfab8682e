"""What `cndhf-batch` shows of a run: a bar, lines, or JSON."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections import Counter
from typing import TextIO

from ..batch.jobs import OUTCOMES, Result
from ..encoder.progress import CLEAR, duration
from ..mesh.wording import counted
from .summary import change
from .terminal import wrapped

BAR = 20  # characters, at most
SHOWN = 0.1  # seconds between two drawings of the bar


class Display:
    """Counts what a run does. Shows failures on stderr, and no more."""

    def __init__(self, quiet: bool = False) -> None:
        self.total = 0
        self.counts: Counter[str] = Counter()
        self.before = 0  # of them, done or failed by an earlier run
        self._fresh_done = 0
        self.source_bytes = self.bytes = 0
        self._quiet = quiet
        self._shares: list[float] = []
        self._flying: dict[str, float] = {}
        self._start = self._last = time.monotonic()

    def found(self, files: int) -> None:
        self.total = files

    def started(self, name: str) -> None:
        self._flying[name] = time.monotonic()

    def ended(self, result: Result) -> None:
        self._flying.pop(result.input, None)
        self.counts[result.outcome] += 1
        self.before += not result.fresh
        self._fresh_done += result.fresh and result.outcome == "done"
        if result.outcome == "done":
            self.source_bytes += result.source_bytes
            self.bytes += result.bytes
            self._shares.append(result.mean_error / result.diagonal)
        elif result.fresh:
            self.failure(result)

    def waiting(self) -> None:
        """Nothing has ended for a second."""

    def failure(self, result: Result) -> None:
        line = f"cndhf-batch: {OUTCOMES[result.outcome]}: {result.input}: {result.reason}\n"
        sys.stderr.write(wrapped(line, sys.stderr))

    def close(self) -> None:
        """Leave the screen to what follows."""

    @property
    def failed(self) -> int:
        return self.counts.total() - self.counts["done"]

    def speed(self) -> float:
        """Files per second; 0 while none is done: one that fails at once does not tell how long others take."""
        if not self._fresh_done:
            return 0.0
        return (self.counts.total() - self.before) / max(time.monotonic() - self._start, 1e-9)

    def summary(self) -> str:
        parts = [f"{count} {OUTCOMES[name]}" for name in OUTCOMES if (count := self.counts[name])]
        lines = [f"{self.total} files: {', '.join(parts) or 'none'}"]
        if self.before:
            lines[0] += f"; {self.before} of them before, and unchanged"
        if self.bytes:
            mean = sum(self._shares) / len(self._shares)
            lines.append(
                f"{change(self.source_bytes, self.bytes)}, mean error {100 * mean:.2g} % of the diagonal on average"
            )
        lines[-1] += f", {duration(time.monotonic() - self._start)}"
        return "\n".join(lines)


class Lines(Display):
    """A line on stdout for each file that is done."""

    def ended(self, result: Result) -> None:
        super().ended(result)
        if result.outcome == "done" and result.fresh and not self._quiet:
            done = f"{self.counts.total()}/{self.total}"
            notes = f", {counted(len(result.warnings), 'warning')}" if result.warnings else ""
            sys.stdout.write(f"{done} {result.input}: {_sizes(result)}, {result.seconds:.0f} s{notes}\n")
            sys.stdout.flush()


class Bar(Display):
    """One line on stderr that is drawn again and again; failures stand above it."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    def started(self, name: str) -> None:
        super().started(name)
        self._draw()

    def ended(self, result: Result) -> None:
        super().ended(result)
        self._draw()

    def waiting(self) -> None:
        self._draw()

    def failure(self, result: Result) -> None:
        self._stream.write(CLEAR)
        super().failure(result)
        self._last = 0.0

    def close(self) -> None:
        self._stream.write(CLEAR)
        self._stream.flush()

    def line(self, columns: int) -> str:
        """What is shown, within the width of a terminal."""
        ended = self.counts.total()
        share = ended / max(self.total, 1)
        filled = round(BAR * share)
        parts = [f"[{'#' * filled}{'.' * (BAR - filled)}] {ended}/{self.total}"]
        speed = self.speed()
        if speed and ended < self.total:
            parts.append(f"{duration((self.total - ended) / speed)} left")
        if self.failed:
            parts.append(f"{self.failed} failed")
        if speed:
            parts.append(f"{60 * speed:.3g} per minute")
        line = parts[0]
        for part in parts[1:]:
            if len(line) + 2 + len(part) < columns:
                line += f", {part}"
        flying = f": {', '.join(self._flying)}" if self._flying else ""
        return f"{line}{flying}"[: columns - 1]

    def _draw(self) -> None:
        now = time.monotonic()
        if now - self._last > SHOWN:
            self._last = now
            self._stream.write(f"{CLEAR}{self.line(shutil.get_terminal_size((80, 24)).columns)}")
            self._stream.flush()


class Json(Display):
    """A JSON object per line on stdout: of each file that starts, of each that ends, and at last the counts."""

    def started(self, name: str) -> None:
        super().started(name)
        self._print({"event": "started", "input": name})

    def ended(self, result: Result) -> None:
        super().ended(result)
        values = {k: v for k, v in vars(result).items() if k != "data"}
        self._print({"event": "ended", "ended": self.counts.total(), "files": self.total, **values})

    def failure(self, result: Result) -> None:
        """It is in the line."""

    def summary(self) -> str:
        counts = {name: self.counts[name] for name in OUTCOMES}
        sizes = {"source_bytes": self.source_bytes, "bytes": self.bytes}
        seconds = round(time.monotonic() - self._start, 3)
        values = {"event": "summary", "files": self.total, **counts, "before": self.before, **sizes, "seconds": seconds}
        return json.dumps(values)

    def _print(self, values: dict[str, object]) -> None:
        sys.stdout.write(f"{json.dumps(values)}\n")
        sys.stdout.flush()


def display(quiet: bool, as_json: bool) -> Display:
    """The one that suits the terminal, or its absence."""
    if as_json:
        return Json()
    if quiet:
        return Display(quiet=True)
    return Bar(sys.stderr) if sys.stderr.isatty() else Lines()


def _sizes(result: Result) -> str:
    share = 100 * result.mean_error / result.diagonal
    return f"{change(result.source_bytes, result.bytes)}, mean error {share:.2g} % of the diagonal"
