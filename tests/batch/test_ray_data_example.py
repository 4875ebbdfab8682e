"""examples/ray_data.py: a dataset in a pipeline."""

from __future__ import annotations

import subprocess
import sys

import pytest
import trimesh
from places import ROOT

pytest.importorskip("ray")
dataset = pytest.importorskip("pyarrow.dataset")
pytestmark = [
    pytest.mark.encode,
    pytest.mark.skipif(sys.platform == "win32", reason="Ray for Windows is experimental"),
]


def test_a_folder_becomes_a_dataset(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    trimesh.creation.box((1, 0.5, 0.25)).export(tmp_path / "in" / "box.ply")
    (tmp_path / "in" / "no.obj").write_text("hello\n")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    arguments = [tmp_path / "in", tmp_path / "out", "--preset", "fast", "--processes", "1"]
    command = [sys.executable, ROOT / "examples" / "ray_data.py", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "2 meshes, 1 of them not encoded"
    rows = {row["path"].rpartition("/")[2]: row for row in dataset.dataset(tmp_path / "out").to_table().to_pylist()}
    assert rows["no.obj"]["reason"]

    from cndhf_codec import loads

    model = loads(rows["box.ply"]["cndhf"])
    assert model.representation == rows["box.ply"]["representation"] == "surface"
    assert rows["box.ply"]["mean_percent"] < 0.1
