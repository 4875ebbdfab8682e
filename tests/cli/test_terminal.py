"""Lines on a terminal end between words; elsewhere they stay whole."""

from __future__ import annotations

import io
import os
import warnings
from functools import partial

import pytest

from cndhf_codec import cli
from cndhf_codec.cli import terminal
from cndhf_codec.cli.terminal import wrapped
from cndhf_codec.encoder.progress import CLEAR
from cndhf_codec.errors import CndhfWarning

LONG = "46.9 kB -> 2.0 kB (23:1), mean error 0.0041 % of the diagonal, p99 0.034 %, maximum 0.11 %, 1 piece, 30 s"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _sixty(monkeypatch):
    monkeypatch.setattr(terminal.shutil, "get_terminal_size", lambda _: os.terminal_size((60, 24)))


def test_a_long_line_is_broken_between_words():
    text = wrapped(f"short\n{LONG}\n", Terminal())
    lines = text.split("\n")
    assert lines[0] == "short"
    assert lines[-1] == ""
    assert len(lines) == 4
    assert all(len(line) <= 60 for line in lines)
    assert " ".join(line.strip() for line in lines[1:3]) == LONG


def test_options_names_and_tables_stay_whole():
    table = "field  axis" + " " * 60 + "width"
    assert wrapped(table, Terminal()) == table
    name = "/a-very-long/folder-name/that-goes-on/and-on-and-on/to-the-end/of-the-line/and-beyond.cndhf"
    assert f"{name}:" in wrapped(f"cndhf-encode: error: {name}: exists already; pass --overwrite", Terminal()).split(
        "\n  "
    )


@pytest.mark.parametrize("stream", [io.StringIO(), None])
def test_off_a_terminal_nothing_is_broken(stream):
    assert wrapped(LONG, stream) == LONG


def test_a_warning_takes_the_place_of_the_progress_bar(monkeypatch):
    stream = Terminal("[####....] 100 %, measuring")
    stream.seek(0, io.SEEK_END)
    monkeypatch.setattr(cli.sys, "stderr", stream)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(warnings, "showwarning", partial(cli._show_warning, "cndhf-encode"))
        warnings.warn("the surface is open", CndhfWarning, stacklevel=1)
    assert stream.getvalue().split(CLEAR)[1] == "cndhf-encode: warning: the surface is open\n"
