"""pyproject.toml and the files beside it."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from places import ROOT

import cndhf_codec

LOWEST = ROOT / "tools" / "ci" / "lowest.py"


def lowest(*extras: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, LOWEST, *extras], capture_output=True, text=True, check=False)


def test_every_dependency_has_a_lower_bound():
    extras = re.findall(r"^(\w+) = \[", (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE)
    extras = extras[extras.index("cli") : extras.index("all") + 1]
    done = lowest(*extras)
    assert done.returncode == 0, done.stderr
    names = {line.split("==")[0] for line in done.stdout.splitlines()}
    assert {"numpy", "click", "torch", "libigl", "pymeshlab", "atheris", "ruff"} <= names


def test_comparing_needs_neither_torch_nor_numba():
    names = {line.split("==")[0] for line in lowest("compare", "report").stdout.splitlines()}
    assert "libigl" in names
    assert not names & {"torch", "numba"}


def test_an_extra_that_is_not_there():
    done = lowest("frobnicate")
    assert done.returncode == 1
    assert "frobnicate" in done.stderr


@pytest.mark.parametrize("name", ["CITATION.cff", "CHANGELOG.md", "README.md"])
def test_what_a_release_needs_is_there(name):
    assert (ROOT / name).is_file()


def test_the_citation_has_the_version():
    assert f"\nversion: {cndhf_codec.__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
