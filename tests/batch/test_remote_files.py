"""Inputs and outputs that URLs name."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import pytest
from poisoned import poison

from cndhf_codec import __version__
from cndhf_codec.batch import encode_many, remote, worker
from cndhf_codec.batch.discovery import find
from cndhf_codec.batch.jobs import Job
from cndhf_codec.batch.run import Order, run
from cndhf_codec.errors import CndhfError, InputError, OptionError

fsspec = pytest.importorskip("fsspec")
GLTF = b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "more/a.bin", "byteLength": 1}]}'


@pytest.fixture
def memory():
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


def test_names_below_and_beside():
    assert remote.join("s3://b/in/", "x/a.ply") == "s3://b/in/x/a.ply"
    assert remote.join("zip://::/d/a.zip", "x/a.ply") == "zip://x/a.ply::/d/a.zip"
    assert remote.join("zip://in::/d/a.zip", "a.ply") == "zip://in/a.ply::/d/a.zip"
    assert remote.beside("zip://a.gltf::/d/a.zip", "a.bin") == "zip://a.bin::/d/a.zip"
    assert remote.join("folder", "x/a.ply") == os.path.join("folder", "x", "a.ply")


def test_a_folder_is_listed_with_stamps_where_the_system_has_some(memory):
    memory.pipe({"/in/a.ply": b"1", "/in/sub/b.obj.gz": b"2", "/in/c.txt": b"3", "/in/.d.ply": b"4"})
    listing = find("memory://in")
    assert [(f.name, f.source, f.output) for f in listing.files] == [
        ("a.ply", "memory://in/a.ply", "a.cndhf"),
        ("sub/b.obj.gz", "memory://in/sub/b.obj.gz", "sub/b.cndhf"),
    ]
    assert [remote._stamp(i) for i in ({"size": 3, "ETag": "x"}, {"size": 3, "mtime": 2.5}, {"size": 3})] == [
        "3 x",
        "3 2.5",
        "",
    ]
    with pytest.raises(InputError, match="memory://gone: is no folder"):
        find("memory://gone")
    with pytest.raises(OptionError, match="frob://a"):
        find("frob://a")


def test_a_worker_fetches_what_a_file_names_and_writes_the_output(memory, monkeypatch):
    memory.pipe({"/in/a.gltf": GLTF, "/in/more/a.bin": b"x"})
    seen = {}

    def encode(source, **options):
        seen.update(
            {str(p.relative_to(source.parent)): p.read_bytes() for p in source.parent.rglob("*") if p.is_file()}
        )
        seen["folder"] = source.parent
        raise CndhfError(f"{source}: seen")

    from cndhf_codec.encoder import pipeline

    monkeypatch.setattr(pipeline, "encode", encode)
    result = worker.work(Job("a", "memory://in/a.gltf", "memory://out/a.cndhf", {}, __version__), 1)
    assert result.reason == "seen"
    assert seen.pop("folder").exists() is False
    assert seen == {"a.gltf": GLTF, os.path.join("more", "a.bin"): b"x"}
    remote.store("memory://out/x/a.cndhf", b"file")
    assert memory.cat("/out/x/a.cndhf") == b"file"
    assert remote.sizes("memory://out") == {"x/a.cndhf": 4}
    assert remote.sizes("memory://gone") == {}


def test_what_cannot_be_fetched_is_named(memory):
    result = worker.work(Job("a", "memory://in/a.ply", None, {}, __version__), 1)
    assert (result.outcome, result.reason) == ("failed", "cannot be read: /in/a.ply")


def test_a_run_from_and_to_urls_is_resumed(memory, tmp_path):
    memory.pipe({"/in/a.obj": b"a", "/in/sub/b.obj": b"bb"})
    order = Order("memory://in", "memory://out", {}, manifest=tmp_path / "m.sqlite")

    class Here:
        """Copies in this process: the file system is of one process."""

        def __init__(self):
            self.seen = []

        def results(self, jobs):
            for job in jobs:
                if job.known:  # as nothing tells whether the file has changed, it is looked into
                    yield worker.Result(job.name, "done", hash=job.known, fresh=False)
                    continue
                data = remote.fetch(job.source, tmp_path).read_bytes()
                self.seen.append(job.name)
                remote.store(job.target, data)
                yield worker.Result(job.name, "done", bytes=len(data), hash="h" * 64, diagonal=1.0)

        def close(self):
            pass

    class Deaf:
        def __getattr__(self, name):
            return lambda *_: None

    first, second = Here(), Here()
    run(order, first, Deaf())
    assert memory.cat("/out/sub/b.cndhf") == b"bb"
    memory.rm("/out/a.cndhf")
    run(order, second, Deaf())
    assert first.seen == ["a.obj", "sub/b.obj"]
    assert second.seen == ["a.obj"]


@pytest.mark.encode
def test_workers_read_from_an_archive(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("x/a.obj", "# fine\n")
        archive.writestr("x/b.obj", "# bad\n")
    assert [f.source for f in find(f"zip://::{tmp_path}/a.zip").files] == [
        f"zip://x/{name}.obj::{tmp_path}/a.zip" for name in "ab"
    ]
    urls = [f"zip://x/{name}.obj::{tmp_path}/a.zip" for name in "ab"]
    found = {r.input: r for r in encode_many(urls, tmp_path / "out", jobs=1, preset="fast")}
    assert [found[url].outcome for url in urls] == ["done", "failed"]
    assert found[urls[1]].reason == "is bad"
    assert Path(found[urls[0]].output).read_bytes() == b"# fine\n" * 2
