"""`cndhf-view`: what it serves and writes, and how it ends."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest
from ctrl_c import CTRL_C

from cndhf_codec.viewer.page import page

RUN = [sys.executable, "-c", f"{CTRL_C}; from cndhf_codec import cli; cli.view()"]


def view(*arguments, **options) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*RUN, *map(str, arguments)], capture_output=True, check=False, **options)


@pytest.mark.skipif(os.name == "nt", reason="no Ctrl-C for one process alone")
def test_it_serves_until_ctrl_c(tmp_path, golden):
    file, opened = tmp_path / "a.cndhf", tmp_path / "opened"
    file.write_bytes((golden / "encoded.cndhf").read_bytes())
    script = tmp_path / "browser.py"
    script.write_text(f"import sys, pathlib\npathlib.Path({str(opened)!r}).write_text(sys.argv[1])\n")
    environment = {**os.environ, "BROWSER": f"{shlex.quote(sys.executable)} {shlex.quote(str(script))} %s"}
    with subprocess.Popen(
        [*RUN, str(file)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        line = process.stdout.readline()
        address = line.removeprefix(f"{file}: ").removesuffix(" (Ctrl-C ends)\n")
        for data in (file.read_bytes(), b"another"):  # a page that is reloaded shows the file as it is then
            file.write_bytes(data)
            with urlopen(address, timeout=30) as answer:
                assert answer.read().decode() == page(data, "a.cndhf")
        for _ in range(300):
            if opened.exists() and opened.read_text():
                break
            time.sleep(0.1)
        assert opened.read_text() == address
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "", "")


def test_a_page_to_send(tmp_path, golden):
    source, target = golden / "encoded.cndhf", tmp_path / "a.html"
    done = view(source, "--html", target)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.decode() == f"{target}: {target.stat().st_size} bytes\n".replace("\n", os.linesep)
    assert target.read_text("utf-8") == page(source.read_bytes(), "encoded.cndhf")
    done = view(source, "--html", target)
    assert done.returncode == 1
    assert b"exists already; pass --overwrite" in done.stderr
    done = view("-", "--html", target, "--overwrite", input=source.read_bytes())
    assert done.returncode == 0
    assert target.read_text("utf-8") == page(source.read_bytes(), "shape.cndhf")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["no.cndhf"], 1, "no.cndhf: cannot be read: No such file"),
        (["."], 1, "cannot be read"),
        (["bad.cndhf", "--html", "a.html"], 1, "bad.cndhf: this is not a .cndhf file"),
        (["bad.cndhf", "--html", "bad.cndhf", "--overwrite"], 1, "is the input itself"),
        (["bad.cndhf", "--html", "a.html", "--port", "8000"], 2, "leave out --port"),
        (["bad.cndhf", "--port", "70000"], 2, "70000"),
    ],
)
def test_failures_are_one_line(tmp_path, arguments, code, message):
    (tmp_path / "bad.cndhf").write_bytes(b"no such file")
    done = view(*arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (code, b"")
    assert done.stderr.startswith(b"cndhf-view: error: ")
    assert len(done.stderr.splitlines()) == 1
    assert message in done.stderr.decode()
    assert os.listdir(tmp_path) == ["bad.cndhf"]
