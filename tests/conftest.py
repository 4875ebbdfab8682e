"""Shared fixtures. This file also puts the folder on the path, for the helper modules beside it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

ROOT = Path(__file__).parent.parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.option.markexpr:
        for item in items:
            if item.get_closest_marker("slow"):
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
    """The `fast` preset becomes a second's work. Its models are rough: for tests that look at anything else."""
    make_tiny(monkeypatch)


def make_tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    from cndhf_codec.encoder import pipeline, report, settings
    from cndhf_codec.mesh.distances import surface_distances

    small = replace(
        settings.PRESETS["fast"],
        max_axes=2,
        width=8,
        steps=150,
        batch=512,
        target_resolution=64,
        verify_resolution=32,
        target_size=None,
        samples=5_000,
        joint_steps=60,
        rounds=2,
        round_steps=20,
    )
    monkeypatch.setitem(settings.PRESETS, "fast", small)
    monkeypatch.setattr(pipeline, "surface_distances", partial(surface_distances, samples=2000))
    # Rough results are warned of, and warnings are errors here.
    monkeypatch.setattr(report, "POOR_ERROR", 1.0)
    monkeypatch.setattr(report.Report, "_changed", lambda _: [])


def stored_normals(path: Path):
    """As the file has them: trimesh computes its own when it loads one."""
    if path.suffix == ".obj":
        return np.array([x.split()[1:] for x in path.read_text("utf-8").splitlines() if x.startswith("vn ")], float)
    if path.suffix == ".ply":
        vertices = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        return np.column_stack([vertices[k] for k in ("nx", "ny", "nz")])
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    head = json.loads(data[20 : 20 + length])
    accessor = head["accessors"][head["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    view = head["bufferViews"][accessor["bufferView"]]
    start = 28 + length + view.get("byteOffset", 0)
    return np.frombuffer(data[start : start + view["byteLength"]], "<f4").reshape(-1, 3)
