"""`cndhf-batch` from end to end."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import re
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh
from ctrl_c import CTRL_C
from places import ROOT
from poisoned import poison, write

from cndhf_codec.batch.jobs import Result
from cndhf_codec.batch.manifest import NAME
from cndhf_codec.cli.batch_display import Bar, display

pytestmark = pytest.mark.encode
OPTIONS = ("--preset", "fast", "--target-size", "500")


def command(name: str, *arguments: object) -> list[str]:
    code = f"{CTRL_C}; from cndhf_codec.cli import {name}; {name}()"
    return [sys.executable, "-c", code, *map(str, arguments)]


def call(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(ROOT)])}
    return subprocess.run(command(name, *arguments), capture_output=True, text=True, check=False, env=environment)


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.cndhf"))}


def test_bytes_are_those_of_cndhf_encode_and_the_report_shows_them(tmp_path):
    (tmp_path / "in" / "sub").mkdir(parents=True)
    trimesh.creation.icosphere(1).export(tmp_path / "in" / "ball.ply")
    trimesh.creation.box((1, 0.5, 0.25)).export(tmp_path / "in" / "sub" / "box.obj")
    (tmp_path / "in" / "no.obj").write_text("hello\n")
    done = call("batch", tmp_path / "in", tmp_path / "out", *OPTIONS, "--jobs", 2)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert sorted(line.split()[1] for line in lines[:2]) in (["ball.ply:", "sub/box.obj:"], [])
    assert lines[-2] == "3 files: 2 encoded, 1 failed"
    assert done.stderr.startswith("cndhf-batch: failed: no.obj: ")
    assert len(done.stderr.splitlines()) == 1
    for source, target in (("ball.ply", "ball.cndhf"), ("sub/box.obj", "sub/box.cndhf")):
        alone = call("encode", tmp_path / "in" / source, tmp_path / "a.cndhf", *OPTIONS, "--overwrite", "--quiet")
        assert alone.returncode == 0, alone.stderr
        assert (tmp_path / "out" / target).read_bytes() == (tmp_path / "a.cndhf").read_bytes()

    pytest.importorskip("matplotlib")
    (tmp_path / "out" / "viewer.html").write_text("")
    done = call("batch", "--report", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "report.tsv").read_text()), delimiter="\t"))
    assert [(r["input"], r["output"], r["outcome"]) for r in rows] == [
        ("ball.ply", "ball.cndhf", "done"),
        ("no.obj", "", "failed"),
        ("sub/box.obj", "sub/box.cndhf", "done"),
    ]
    size = (tmp_path / "in" / "ball.ply").stat().st_size
    assert int(rows[0]["source_bytes"]) == size
    assert float(rows[0]["ratio"]) == pytest.approx(size / int(rows[0]["bytes"]), abs=1e-3)
    text = (tmp_path / "out" / "report.html").read_text()
    assert text.count("data:image/png;base64,iVBORw0KGgo") == 4
    assert 'href="viewer.html?url=sub%2Fbox.cndhf"' in text
    first, second = sorted((rows[0], rows[2]), key=lambda r: float(r["mean_percent"]), reverse=True)
    assert text.index(f">{first['input']}<") < text.index(f">{second['input']}<")
    assert "Not encoded" in text

    (tmp_path / "in" / "sub" / "box.obj").unlink()  # what has gone is said in place of its picture
    call("batch", "--report", tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text()
    assert text.count("data:image/png;base64,iVBORw0KGgo") == 3
    assert "no such file" in text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes and signals")
def test_json_names_all_that_is_bad_and_an_exit_code_says_so(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    write(tmp_path / "in", a="fine", b="crash", c="bad", d="hang", e="eat")
    os.mkfifo(tmp_path / "in" / "pipe.ply")
    limits = ("--timeout", 10, "--memory", "0.9GB", "--json")
    done = call("batch", tmp_path / "in", tmp_path / "out", "--preset", "fast", *limits)
    assert (done.returncode, done.stderr) == (1, "")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[-1]["event"] == "summary"
    counts = {name: lines[-1][name] for name in ("done", "failed", "crashed", "memory", "timeout", "refused")}
    assert counts == {"done": 1, "failed": 1, "crashed": 1, "memory": 1, "timeout": 1, "refused": 1}
    ended = {line["input"]: line for line in lines if line["event"] == "ended"}
    assert len(ended) == 6
    assert all(line["reason"] for name, line in ended.items() if name != "a.obj")
    again = call("batch", tmp_path / "in", tmp_path / "out", "--preset", "fast", *limits)
    assert again.returncode == 1
    assert json.loads(again.stdout.splitlines()[-1])["before"] == 5  # a pipe may be a file by now: it is looked at


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs signals")
def test_killed_three_times_and_run_again_every_file_is_there_once_and_whole(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    write(tmp_path / "in", **{f"m{k:02}": f"fine {0.1 * (k % 4)}" for k in range(24)})
    arguments = (tmp_path / "in", tmp_path / "out", "--preset", "fast", "--jobs", 2, "--json")
    for kill in range(3):
        process = subprocess.Popen(command("batch", *arguments), stdout=subprocess.PIPE, text=True)
        for line in process.stdout:
            if json.loads(line)["event"] == "ended" and len(tree(tmp_path / "out")) >= 5 * (kill + 1):
                break
        process.kill()
        process.communicate()
    time.sleep(0.5)  # what the orphans still write
    before = len(tree(tmp_path / "out"))
    assert 15 <= before < 24
    done = call("batch", *arguments)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout.splitlines()[-1])
    assert summary["done"] == summary["files"] == 24
    assert before - 4 <= summary["before"] <= before  # the rest was in flight, or written and not yet recorded
    content = {f"m{k:02}.cndhf": (tmp_path / "in" / f"m{k:02}.obj").read_bytes() * 2 for k in range(24)}
    assert tree(tmp_path / "out") == content
    with sqlite3.connect(tmp_path / "out" / NAME) as base:
        rows = base.execute("SELECT input, outcome FROM files").fetchall()
    base.close()
    assert sorted(rows) == [(f"m{k:02}.obj", "done") for k in range(24)]
    assert [p.name for p in (tmp_path / "out").iterdir() if p.name.endswith(".tmp")] == []


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs signals")
def test_interrupted_is_one_line(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    write(tmp_path / "in", a="fine", b="hang")
    arguments = (tmp_path / "in", tmp_path / "out", "--preset", "fast", "--jobs", 1)
    process = subprocess.Popen(
        command("batch", *arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout.readline().startswith("1/2 a.obj")
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C: the workers get it, too
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (130, "")
    assert err == "cndhf-batch: interrupted; 1 files are done, run again for the others\n"


def test_wrong_arguments_are_one_line(tmp_path):
    (tmp_path / "in").mkdir()
    for arguments, code, says in (
        ((), 2, "IN and OUT are missing"),
        ((tmp_path / "in",), 2, "IN and OUT are needed"),
        (("--report", "a", "b"), 2, "OUT alone"),
        ((tmp_path / "in", tmp_path / "out", "--target-size", "1"), 2, "target size is 1 bytes"),
        ((tmp_path / "in", tmp_path / "out", "--memory", "much"), 2, "memory is 'much'"),
        ((tmp_path / "gone", tmp_path / "out"), 1, "no such folder"),
        (("--report", tmp_path / "gone"), 1, "no such manifest"),
    ):
        done = call("batch", *arguments)
        assert (done.returncode, done.stdout) == (code, ""), done.stderr
        assert done.stderr.startswith("cndhf-batch: error: ")
        assert says in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_nothing_to_do(tmp_path):
    (tmp_path / "in").mkdir()
    done = call("batch", tmp_path / "in", tmp_path / "out", "--preset", "fast")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("0 files: none")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a pseudo-terminal")
def test_a_bar_on_a_terminal(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    write(tmp_path / "in", a="fine", b="bad", c="fine 1.5")
    here, there = pty.openpty()
    process = subprocess.Popen(
        command("batch", tmp_path / "in", tmp_path / "out", "--preset", "fast", "--jobs", 1),
        stdout=subprocess.PIPE,
        stderr=there,
    )
    out = process.communicate()[0].decode()
    os.close(there)
    shown = os.read(here, 100_000).decode()
    os.close(here)
    assert "cndhf-batch: failed: b.obj: is bad" in shown
    assert "] 2/3, " in shown
    assert "per minute" in shown
    assert "1 failed, " in shown
    assert "per minute: c.obj" in shown
    assert out.startswith("3 files: 2 encoded, 1 failed\n")


def test_a_bar_keeps_to_the_terminal():
    bar = Bar(io.StringIO())
    bar.found(10)
    for name in ("a.ply", "b.ply"):
        bar.started(name)
    assert bar.line(80) == "[....................] 0/10: a.ply, b.ply"
    assert len(bar.line(30)) == 29
    bar.ended(Result("a.ply", "failed", reason="empty"))
    assert bar.line(80) == "[##..................] 1/10, 1 failed: b.ply"  # which does not tell how long others take
    bar.ended(Result("b.ply", "done", bytes=9, source_bytes=90, diagonal=1.0))
    assert re.fullmatch(r"\[####\.+\] 2/10, .* left, 1 failed, .* per minute", bar.line(80))
    assert type(display(True, True)).__name__ == "Json"
