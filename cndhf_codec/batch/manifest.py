"""The manifest: an SQLite file that says what became of each input."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ..errors import InputError, OutputError
from .jobs import Job, Result

NAME = "cndhf-batch.sqlite"  # in the output folder
VERSION = 1  # of the table
STARTED = "started"  # the outcome while a file is worked on

TABLE = """CREATE TABLE IF NOT EXISTS files (
    input TEXT PRIMARY KEY, output TEXT NOT NULL, stamp TEXT NOT NULL, hash TEXT NOT NULL,
    options TEXT NOT NULL, version TEXT NOT NULL, outcome TEXT NOT NULL, reason TEXT NOT NULL,
    source_bytes INTEGER NOT NULL, bytes INTEGER NOT NULL, representation TEXT NOT NULL,
    mean_error REAL NOT NULL, p99_error REAL NOT NULL, max_error REAL NOT NULL, diagonal REAL NOT NULL,
    seconds REAL NOT NULL, warnings TEXT NOT NULL) WITHOUT ROWID"""


@dataclass(frozen=True)
class Row:
    """What is known of an input. stamp: of the file when it was read; hash: of its content; options: as JSON; version:
    of the package; outcome: of jobs.Outcome, or STARTED; the rest as in `Result`."""

    input: str
    output: str
    stamp: str
    hash: str
    options: str
    version: str
    outcome: str
    reason: str
    source_bytes: int
    bytes: int
    representation: str
    mean_error: float
    p99_error: float
    max_error: float
    diagonal: float
    seconds: float
    warnings: tuple[str, ...]

    def result(self) -> Result:
        """As the result of a run that had nothing to do."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(Result) if hasattr(self, f.name)}
        return Result(**{**values, "output": self.output if self.outcome == "done" else ""}, fresh=False)


class Manifest:
    """The table of one output folder. For one process at a time; others may read it meanwhile."""

    def __init__(self, path: Path, create: bool = True) -> None:
        """Open a manifest, or make it. Raises OutputError, InputError."""
        if not create and not path.is_file():
            raise InputError(f"{path}: no such manifest; name the OUT of a cndhf-batch, or its --manifest")
        self._path = path
        try:
            self._base = sqlite3.connect(path, isolation_level=None)
            # A commit that need not wait for the disk: after a crash of the machine the last files are done again.
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=NORMAL")
            version = self._base.execute("PRAGMA user_version").fetchone()[0]
            if version not in (0, VERSION):
                raise InputError(f"{path}: is of a newer version of cndhf-codec; use that, or another OUT")
            self._base.execute(TABLE)
            self._base.execute("CREATE TABLE IF NOT EXISTS about (key TEXT PRIMARY KEY, value TEXT NOT NULL)")
            self._base.execute(f"PRAGMA user_version={VERSION}")
        except sqlite3.Error as exc:
            raise OutputError(f"{path}: cannot be used as a manifest: {exc}; remove it, or name another") from exc

    def get(self, name: str) -> Row | None:
        found = self._all("SELECT * FROM files WHERE input = ?", (name,))
        return found[0] if found else None

    def rows(self) -> Iterator[Row]:
        """All inputs, by name."""
        yield from self._all("SELECT * FROM files ORDER BY input")

    def begin(self, job: Job, output: str) -> None:
        """Say that an output is being made, before it may be there: it is known for one of ours then."""
        new = Row(job.name, output, "", "", "", "", STARTED, "", 0, 0, "", 0, 0, 0, 0, 0, ())
        self._put(new, "ON CONFLICT (input) DO UPDATE SET output = excluded.output, outcome = excluded.outcome")

    def record(self, row: Row) -> None:
        """Say what became of an input: its output is in place."""
        self._put(row, "")

    def about(self, key: str) -> str:
        found = self._base.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone()
        return str(found[0]) if found else ""

    def set_about(self, key: str, value: str) -> None:
        self._base.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (key, value))

    def close(self) -> None:
        self._base.close()

    def _all(self, query: str, values: tuple[str, ...] = ()) -> list[Row]:
        def row(columns: tuple[Any, ...]) -> Row:
            named = dict(zip((f.name for f in fields(Row)), columns, strict=True))
            return Row(**{**named, "warnings": tuple(json.loads(named["warnings"]))})

        return [row(columns) for columns in self._base.execute(query, values)]

    def _put(self, row: Row, conflict: str) -> None:
        values = [json.dumps(v, ensure_ascii=False) if isinstance(v, tuple) else v for v in vars(row).values()]
        verb = "INSERT" if conflict else "INSERT OR REPLACE"
        marks = ", ".join("?" * len(values))
        try:
            self._base.execute(f"{verb} INTO files VALUES ({marks}) {conflict}", values)
        except sqlite3.Error as exc:  # a full disk
            raise OutputError(f"{self._path}: cannot be written: {exc}; run again when it can") from exc
