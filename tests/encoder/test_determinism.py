"""Equal input and seed give equal bytes: in another process, with other threads, from another kind of file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import manifold3d
import numpy as np
import pytest
import trimesh

from cndhf_codec import encode

pytestmark = pytest.mark.encode

# As `tiny`, in an interpreter of its own.
ENCODE = """
import sys
sys.path.insert(0, sys.argv[1])
import pytest, cndhf_codec, small
small.make_tiny(pytest.MonkeyPatch())
options = {"preset": "fast", "representation": "dhf", "seed": 3, "threads": int(sys.argv[3])}
sys.stdout.buffer.write(cndhf_codec.encode(sys.argv[2], **options).dumps())
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """One solid, with coordinates that are exact in float32 and in short decimals, in every kind of file."""
    folder = tmp_path_factory.mktemp("same")
    solid = manifold3d.Manifold.cube((4, 3, 2)) - manifold3d.Manifold.cube((1, 1, 4)).translate((1, 1, -1))
    mesh = solid.to_mesh()
    same = trimesh.Trimesh(np.round(8 * mesh.vert_properties[:, :3]) / 8, mesh.tri_verts, process=False)
    for kind in ("ply", "obj", "glb"):
        same.export(folder / f"a.{kind}")
    return {kind: folder / f"a.{kind}" for kind in ("ply", "obj", "glb")}


@pytest.mark.usefixtures("tiny")
def test_another_process_and_other_threads(files):
    here = encode(files["ply"], preset="fast", representation="dhf", seed=3, threads=1).dumps()
    command = [sys.executable, "-c", ENCODE, str(Path(__file__).parent.parent), str(files["ply"]), "2"]
    environment = {**os.environ, "PYTHONHASHSEED": "1" if os.environ.get("PYTHONHASHSEED") != "1" else "2"}
    assert subprocess.run(command, capture_output=True, env=environment, check=True).stdout == here


@pytest.mark.usefixtures("tiny")
def test_the_same_geometry_from_every_kind_of_file(files):
    made = {kind: encode(path, preset="fast", representation="dhf", seed=3).dumps() for kind, path in files.items()}
    assert {kind for kind in made if made[kind] == made["ply"]} == set(files)


GRADIENT = """
import sys
import numpy as np
from cndhf_codec.encoder.dhf.network import kernel
rng = np.random.default_rng(0)
theta, uv, g = (rng.uniform(-0.3, 0.3, n).astype(np.float32) for n in (5 * 64 + 82, (1000, 2), (1000, 2)))
sys.stdout.buffer.write(kernel.heights_gradient(kernel.Net(theta, 8, 6, np.float32(30)), uv, g).tobytes())
"""


def test_code_from_numba_s_cache_gives_the_same_as_fresh_code(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    fresh, cached = (
        subprocess.run([sys.executable, "-c", GRADIENT], capture_output=True, env=environment, check=True).stdout
        for _ in range(2)
    )
    assert any(tmp_path.rglob("*.nbc"))
    assert fresh == cached
