"""Encode what is below a folder, and is not encoded already."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from .. import __version__
from ..errors import OptionError, OutputError
from . import remote
from .discovery import Found, find
from .jobs import Job, Result, Runner
from .lock import locked
from .manifest import NAME, STARTED, Manifest, Row


@dataclass(frozen=True)
class Order:
    """What is asked of a run.

    source, target: folders, as paths or URLs. include: patterns of names, see `discovery.find`. options: those of
    `encode`. manifest: its path; in the target by default. force: encode what is done, too. retry_failed: try again
    what has failed. overwrite: replace outputs that no earlier run has made.
    """

    source: str
    target: str
    options: Mapping[str, Any] = field(default_factory=dict)
    include: Sequence[str] = ()
    manifest: Path | None = None
    force: bool = False
    retry_failed: bool = False
    overwrite: bool = False

    @property
    def manifest_path(self) -> Path:
        """Raises OptionError where the target is a URL and no path is given."""
        if self.manifest is not None:
            return self.manifest
        if remote.is_url(self.target):
            raise OptionError(f"{self.target}: a URL has no place for the manifest; name a file with --manifest")
        return Path(self.target) / NAME


class Watcher(Protocol):
    """What is told of a run as it goes on."""

    def found(self, files: int) -> None: ...
    def started(self, name: str) -> None: ...
    def ended(self, result: Result) -> None: ...
    def waiting(self) -> None: ...


def run(order: Order, runner: Runner, watcher: Watcher) -> None:
    """Encode the files that are missing or changed, and record what became of each.

    An output is in place before the manifest says so. After a run that was killed, the next one does what is missing.
    Raises InputError, OutputError (another run is at work; the manifest cannot be written), OptionError, EncodeError.
    """
    path = order.manifest_path
    for folder in (path.parent, *([] if remote.is_url(order.target) else [Path(order.target)])):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as exc:
            raise OutputError(f"{folder}: cannot be made: {exc.strerror}") from exc
    with locked(path.with_name(f".{path.name}.lock"), order.target):
        manifest = Manifest(path)
        try:
            _Run(order, manifest, watcher).through(runner)
        finally:
            manifest.close()


class _Run:
    def __init__(self, order: Order, manifest: Manifest, watcher: Watcher) -> None:
        self._order, self._manifest, self._watcher = order, manifest, watcher
        self._options = json.dumps(dict(order.options), sort_keys=True)
        # Of a URL all at once: a question for each file would take as long as the encodes.
        self._sizes = remote.sizes(order.target) if remote.is_url(order.target) else None
        self._given: dict[str, tuple[Found, Row | None]] = {}  # files that are worked on

    def through(self, runner: Runner) -> None:
        order = self._order
        listing = find(order.source, order.include)
        source = order.source if remote.is_url(order.source) else os.path.abspath(order.source)
        self._manifest.set_about("source", source)
        self._watcher.found(len(listing.files) + len(listing.refused))
        for name, reason in listing.refused:
            self._record(Found(name, "", "", ""), Result(name, "refused", reason=reason))
        for result in runner.results(self._jobs(listing.files)):
            if result is None:
                self._watcher.waiting()
                continue
            found, row = self._given.pop(result.input)
            if not result.fresh:
                assert row is not None
                self._manifest.record(replace(row, stamp=found.stamp))
                self._watcher.ended(row.result())
            else:
                self._record(found, replace(result, output=found.output if result.outcome == "done" else ""))

    def _jobs(self, files: Sequence[Found]) -> Iterator[Job]:
        """The files that have to be encoded, or looked into."""
        order = self._order
        for found in files:
            row, target = self._manifest.get(found.name), remote.join(order.target, found.output)
            known = self._known(found, row)
            if row is not None and known and found.stamp and found.stamp == row.stamp:
                self._watcher.ended(row.result())
                continue
            ours = row is not None and row.output == found.output
            if not (ours or order.overwrite) and self._size(found.output) is not None:
                reason = f"{target}: exists, and no earlier run has made it; pass --overwrite to replace it"
                self._record(Found(found.name, "", "", ""), Result(found.name, "failed", reason=reason))
                continue
            job = Job(found.name, found.source, target, order.options, __version__, known)
            self._given[found.name] = found, row
            self._manifest.begin(job, found.output)
            self._watcher.started(found.name)
            yield job

    def _known(self, found: Found, row: Row | None) -> str:
        """Hash of the content with which this file would be what it is already; "" where it has to be encoded."""
        if row is None or self._order.force:
            return ""
        if (row.output, row.options, row.version) != (found.output, self._options, __version__):
            return ""
        if row.outcome == "done":
            return row.hash if self._size(found.output) == row.bytes else ""
        return "" if self._order.retry_failed or row.outcome == STARTED else row.hash

    def _size(self, output: str) -> int | None:
        """Bytes of an output before this run; None where there is none."""
        if self._sizes is not None:
            return self._sizes.get(output)
        with suppress(OSError, ValueError):
            return os.stat(remote.join(self._order.target, output)).st_size
        return None

    def _record(self, found: Found, result: Result) -> None:
        values = {k: v for k, v in vars(result).items() if k not in ("fresh", "data", "output")}
        self._manifest.record(
            Row(output=found.output, stamp=found.stamp, options=self._options, version=__version__, **values)
        )
        self._watcher.ended(result)
