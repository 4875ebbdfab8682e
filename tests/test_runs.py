"""Runs that end badly: killed, or out of disk. The output is then absent, the old one, or the new one whole."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

pytestmark = [
    pytest.mark.encode,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL"),
]

# Forks a child for every run, so that its seconds are spent on work and not on imports. Half of the kills come at a
# random moment of the run, half within a millisecond of the temporary file's appearance.
KILLER = """
import json, os, random, signal, sys, time
from dataclasses import replace
from pathlib import Path
name, source, target, kills, overwrite = sys.argv[1:]
target, kills, overwrite = Path(target), int(kills), overwrite == "True"
from cndhf_codec import cli
command = getattr(cli, name)
if name == "encode":
    import igl, numba, torch, trimesh
    import cndhf_codec.cli.encode, cndhf_codec.encoder.pipeline, cndhf_codec.encoder.dhf.encode
    from cndhf_codec.encoder import settings
    settings.PRESETS["fast"] = replace(
        settings.PRESETS["fast"], max_axes=1, width=6, target_size=None, steps=20, batch=256, target_resolution=48,
        verify_resolution=24, samples=2000, joint_steps=20, rounds=1, round_steps=5,
    )
    options = ["--preset", "fast", "--representation", "dhf", "--threads", "1"]
else:
    import skimage.measure, trimesh
    import cndhf_codec.cli.decode, cndhf_codec.decoder.meshfile, cndhf_codec.decoder.model, cndhf_codec.decoder.reading
    options = ["--resolution", "64"]

def start():
    child = os.fork()
    if child == 0:
        sys.argv = ["cndhf-" + name, source, str(target), "--quiet", "--overwrite", *options]
        command()
        os._exit(1)
    return child

def whole_run():
    begin = time.monotonic()
    assert os.waitpid(start(), 0)[1] == 0
    return time.monotonic() - begin

whole_run()  # what is compiled or cached by the first run is there for the others
seconds = whole_run()
new = target.read_bytes()
states = {"old": 0, "new": 0, "absent": 0, "damaged": 0, "leftovers": 0, "ended before": 0}
random.seed(1)
for k in range(kills):
    if overwrite:
        target.write_bytes(b"old")
    else:
        target.unlink(missing_ok=True)
    before = set(os.listdir(target.parent))
    child = start()
    if k % 2:
        time.sleep(random.uniform(0, 1.1 * seconds))
    else:
        end = time.monotonic() + 10 * seconds
        while set(os.listdir(target.parent)) == before and time.monotonic() < end:
            time.sleep(2e-4)
        time.sleep(random.choice((0, 0, 1e-4, 1e-3)))
    os.kill(child, signal.SIGKILL)
    states["ended before"] += not os.WIFSIGNALED(os.waitpid(child, 0)[1])
    data = target.read_bytes() if target.exists() else None
    states["absent" if data is None else "old" if data == b"old" else "new" if data == new else "damaged"] += 1
    states["leftovers"] += any(n.endswith(".tmp") for n in os.listdir(target.parent))
whole_run()
assert target.read_bytes() == new
left = [p for p in target.parent.iterdir() if p.suffix == ".tmp" and p.stat().st_size]
print(json.dumps({**states, "left at the end": len(left)}))
"""


def kill(name: str, source: Path, target: Path, kills: int, overwrite: bool) -> dict[str, int]:
    command = [sys.executable, "-c", KILLER, name, str(source), str(target), str(kills), str(overwrite)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    states = json.loads(done.stdout.splitlines()[-1])
    sys.stdout.write(f"{name}, overwrite {overwrite}: {states}\n")
    return states


@pytest.mark.parametrize(
    ("name", "kills"),
    [
        pytest.param("decode", 6),
        pytest.param("decode", 50, marks=pytest.mark.slow),
        pytest.param("encode", 50, marks=pytest.mark.slow),
    ],
)
def test_a_killed_run_leaves_the_old_output_or_the_new_one(golden, tmp_path, name, kills):
    (tmp_path / "out").mkdir()
    if name == "encode":
        source, target = tmp_path / "box.ply", tmp_path / "out" / "a.cndhf"
        trimesh.creation.box((1, 0.5, 0.25)).export(source)
    else:
        source, target = golden / "encoded.cndhf", tmp_path / "out" / "a.ply"
    for overwrite in (True, False):
        states = kill(name, source, target, kills // 2, overwrite)
        assert states["damaged"] == 0
        assert states["absent"] == 0 or not overwrite
        assert states["ended before"] < kills // 2
        assert states["left at the end"] == 0


def limited(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A command line in a process that may write files of 300 bytes at most, as on a disk that is full."""
    setup = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300)); "
    command = [sys.executable, "-c", setup + code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [["a.ply"], ["--occupancy", "a.npz"]], ids=["mesh", "grid"])
def test_a_full_disk_is_one_line_and_the_old_output_stays(golden, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / arguments[-1]).write_bytes(b"old")
    code = "from cndhf_codec.cli import decode; decode()"
    done = limited(code, golden / "encoded.cndhf", *arguments, "--resolution", 32, "--overwrite")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"cndhf-decode: error: {arguments[-1]}: cannot be written: File too large\n"
    assert os.listdir(tmp_path) == [arguments[-1]]
    assert (tmp_path / arguments[-1]).read_bytes() == b"old"


def test_a_full_disk_when_a_model_is_saved(golden, tmp_path):
    code = "import sys, cndhf_codec; cndhf_codec.load(sys.argv[1]).save(sys.argv[2])"
    done = limited(code, golden / "encoded.cndhf", tmp_path / "a.cndhf")
    assert "OutputError" in done.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(not os.path.isdir("/sys/kernel"), reason="a folder that not even root may write to")
def test_a_read_only_folder_is_one_line(golden):
    code = "from cndhf_codec.cli import decode; decode()"
    command = [sys.executable, "-c", code, str(golden / "encoded.cndhf"), "/sys/kernel/a.ply", "--resolution", "16"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("cndhf-decode: error: /sys/kernel/a.ply: ")
    assert len(done.stderr.splitlines()) == 1
