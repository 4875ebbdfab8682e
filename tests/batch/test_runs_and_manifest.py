"""What a run does and leaves alone, with an encoder that only copies."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cndhf_codec.batch import run as run_module
from cndhf_codec.batch.content import hash_of
from cndhf_codec.batch.jobs import Job, Result
from cndhf_codec.batch.manifest import NAME, Manifest
from cndhf_codec.batch.run import Order, run
from cndhf_codec.errors import InputError, OptionError, OutputError


class Copies:
    """A runner whose files are copies; it fails for those that say so."""

    def __init__(self, dies_after: int | None = None) -> None:
        self.seen: list[str] = []
        self._dies_after = dies_after

    def results(self, jobs: Iterator[Job]) -> Iterator[Result | None]:
        for job in jobs:
            content, data = hash_of(Path(job.source)), Path(job.source).read_bytes()
            if content == job.known:
                yield Result(job.name, "done", hash=content, fresh=False)
                continue
            self.seen.append(job.name)
            yield None
            if b"bad" in data:
                yield Result(job.name, "failed", reason="is bad", hash=content)
                continue
            Path(job.target).parent.mkdir(parents=True, exist_ok=True)
            Path(job.target).write_bytes(data)
            if self._dies_after is not None and len(self.seen) > self._dies_after:
                raise SystemExit  # the output is there, the manifest does not say so
            yield Result(job.name, "done", output=job.target, hash=content, bytes=len(data), diagonal=1.0)

    def close(self) -> None:
        pass


class Seen:
    def __init__(self) -> None:
        self.files, self.results = 0, []

    def found(self, files: int) -> None:
        self.files = files

    def started(self, name: str) -> None:
        pass

    def ended(self, result: Result) -> None:
        self.results.append(result)

    def waiting(self) -> None:
        pass


@pytest.fixture
def order(tmp_path) -> Order:
    for name in ("a.obj", "sub/b.obj", "sub/bad.obj"):
        put(tmp_path / "in" / name, name)
    return Order(str(tmp_path / "in"), str(tmp_path / "out"), {"preset": "fast"})


def put(path: Path, text: str, when: float = 1e9) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    os.utime(path, (when, when))


def again(order: Order, **changes) -> tuple[list[str], Seen]:
    """What a run encodes, and what it tells."""
    copies, seen = Copies(), Seen()
    run(replace(order, **changes), copies, seen)
    return copies.seen, seen


def test_a_second_run_has_nothing_to_do(order, tmp_path):
    done, seen = again(order)
    assert done == ["a.obj", "sub/b.obj", "sub/bad.obj"]
    assert [(r.input, r.outcome, r.output, r.fresh) for r in seen.results] == [
        ("a.obj", "done", "a.cndhf", True),
        ("sub/b.obj", "done", "sub/b.cndhf", True),
        ("sub/bad.obj", "failed", "", True),
    ]
    assert sorted(p.name for p in (tmp_path / "out").rglob("*.cndhf")) == ["a.cndhf", "b.cndhf"]
    done, seen = again(order)
    assert done == []
    assert [(r.outcome, r.reason, r.fresh) for r in seen.results] == [
        ("done", "", False),
        ("done", "", False),
        ("failed", "is bad", False),
    ]


def test_what_is_done_again(order, tmp_path, monkeypatch):
    again(order)
    assert again(order, force=True)[0] == ["a.obj", "sub/b.obj", "sub/bad.obj"]
    assert again(order, retry_failed=True)[0] == ["sub/bad.obj"]
    assert again(order, options={"preset": "best"})[0] == ["a.obj", "sub/b.obj", "sub/bad.obj"]
    assert again(order, options={"preset": "best"})[0] == []
    monkeypatch.setattr(run_module, "__version__", "another")
    assert len(again(order)[0]) == 3


def test_a_change_of_content_counts_and_not_one_of_time(order, tmp_path):
    again(order)
    put(tmp_path / "in" / "a.obj", "a.obj", 1.1e9)
    put(tmp_path / "in" / "sub" / "b.obj", "other", 1.1e9)
    assert again(order)[0] == ["sub/b.obj"]
    assert again(order)[0] == []
    with open(tmp_path / "out" / "a.cndhf", "a") as file:
        file.write("!")
    (tmp_path / "out" / "sub" / "b.cndhf").unlink()
    assert again(order)[0] == ["a.obj", "sub/b.obj"]
    put(tmp_path / "in" / "sub" / "bad.obj", "good now")
    assert again(order)[0] == ["sub/bad.obj"]
    assert again(order)[0] == []


def test_a_file_beside_a_gltf_belongs_to_it(order, tmp_path):
    put(tmp_path / "in" / "c.gltf", '{"buffers": [{"uri": "c%20.bin"}, {"uri": "data:,x"}, {"uri": "../c.bin"}]}')
    put(tmp_path / "in" / "c .bin", "1")
    again(order)
    assert again(order)[0] == []
    put(tmp_path / "in" / "c .bin", "2")
    assert again(order)[0] == ["c.gltf"]


def test_a_run_that_was_killed_is_completed(order, tmp_path):
    with pytest.raises(SystemExit):
        run(order, Copies(dies_after=1), Seen())
    assert (tmp_path / "out" / "sub" / "b.cndhf").exists()  # it is no stranger's, though nothing says that it is done
    done, seen = again(order)
    assert done == ["sub/b.obj", "sub/bad.obj"]
    assert [r.outcome for r in seen.results] == ["done", "done", "failed"]


def test_an_output_that_no_run_has_made_stays(order, tmp_path):
    put(tmp_path / "out" / "a.cndhf", "precious")
    for _ in range(2):
        _, seen = again(order)
        assert seen.results[0].outcome == "failed"
        assert "--overwrite" in seen.results[0].reason
        assert (tmp_path / "out" / "a.cndhf").read_text() == "precious"
    assert again(order, overwrite=True)[0] == ["a.obj"]
    assert (tmp_path / "out" / "a.cndhf").read_text() == "a.obj"


def test_a_second_run_at_once_is_refused(order, tmp_path):
    class Nested(Copies):
        def results(self, jobs):
            with pytest.raises(OutputError, match=rf"out: another cndhf-batch is at work.*{os.getpid()}"):
                run(order, Copies(), Seen())
            yield from super().results(jobs)

    nested = Nested()
    run(order, nested, Seen())
    assert len(nested.seen) == 3


def test_a_manifest_elsewhere(order, tmp_path):
    again(order, manifest=tmp_path / "kept" / "m.sqlite")
    assert (tmp_path / "kept" / "m.sqlite").exists()
    assert not (tmp_path / "out" / NAME).exists()
    with pytest.raises(OptionError, match="--manifest"):
        again(order, target="memory://out")


def test_what_is_no_manifest(order, tmp_path):
    put(tmp_path / "out" / NAME, "no database, but long enough to be taken for one" * 40)
    with pytest.raises(OutputError, match="cannot be used as a manifest"):
        again(order)
    with pytest.raises(InputError, match="no such manifest"):
        Manifest(tmp_path / "gone.sqlite", create=False)


def test_a_manifest_of_a_later_version(tmp_path):
    import sqlite3

    with sqlite3.connect(tmp_path / "m.sqlite") as base:
        base.execute("PRAGMA user_version=9")
    base.close()
    with pytest.raises(InputError, match="newer version"):
        Manifest(tmp_path / "m.sqlite")
