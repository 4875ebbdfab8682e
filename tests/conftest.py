"""Shared fixtures. This file also puts the folder on the path, for the helper modules beside it."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from places import ROOT
from small import make_tiny


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    asked = config.option.markexpr
    for item in items:
        if "tiny" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.encode)
        if item.get_closest_marker("slow") and not re.search(r"\bslow\b|\bquality\b", asked.replace("not slow", "")):
            item.add_marker(pytest.mark.skip(reason="slow: run with -m slow"))


@pytest.fixture(scope="session")
def golden() -> Path:
    return ROOT / "tests" / "golden"


@pytest.fixture(scope="session")
def bracket() -> Path:
    return ROOT / "examples" / "bracket.ply"


@pytest.fixture(scope="session")
def creature() -> Path:
    return ROOT / "examples" / "creature.ply"


@pytest.fixture(scope="session")
def corpus() -> Path:
    folder = Path(os.environ.get("CNDHF_CORPUS", ROOT.parent / "shared" / "corpus"))
    if not folder.is_dir():
        pytest.skip(f"no mesh corpus at {folder}; name one in CNDHF_CORPUS")
    return folder


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the `fast` preset take about a second. Its models are rough: for tests that do not look at their quality."""
    make_tiny(monkeypatch)
