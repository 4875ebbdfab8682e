"""Each example, on small data."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from normals import stored_normals
from places import ROOT

sys.path.insert(0, str(ROOT / "examples"))


@pytest.mark.encode
@pytest.mark.usefixtures("tiny")
def test_game_assets(tmp_path):
    import game_assets

    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.box((1, 0.5, 0.25)).export(meshes / "box.ply")
    trimesh.creation.icosphere(4).export(meshes / "ball.obj")
    (meshes / "box.stl").write_text("")
    (meshes / "broken.stl").write_text("no mesh")
    (meshes / "notes.txt").write_text("left alone")
    kept, built = tmp_path / "kept", tmp_path / "built"
    failures = game_assets.build(meshes, kept, built, preset="fast", lods=2)
    assert len(failures) == 2
    assert failures[0].startswith("box.stl: has the name of box.ply")
    assert failures[1].startswith("broken.stl: ")
    assert sorted(os.listdir(kept)) == ["ball.cndhf", "box.cndhf"]
    assert sorted(os.listdir(built)) == [f"{name}.lod{k}.glb" for name in ("ball", "box") for k in (0, 1)]
    fine, coarse = (trimesh.load_mesh(built / f"ball.lod{k}.glb", process=False) for k in (0, 1))
    assert len(coarse.faces) < 0.4 * len(fine.faces)
    for k, mesh in enumerate((fine, coarse)):
        assert stored_normals(built / f"ball.lod{k}.glb").shape == mesh.vertices.shape

    before = (kept / "box.cndhf").stat().st_mtime_ns
    game_assets.build(meshes, kept, built, preset="fast", lods=1)
    assert (kept / "box.cndhf").stat().st_mtime_ns == before  # nothing new to store


def run(name, *arguments):
    command = [sys.executable, ROOT / "examples" / name, *arguments]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_robot_collision(golden):
    lines = run("robot_collision.py", golden / "encoded.cndhf").splitlines()
    assert len(lines) == 7
    assert ": free, for another " in lines[0]
    assert "points inside" in lines[-1]


@pytest.mark.parametrize("name", ["robot_collision.py", "torch_fit_pose.py"])
def test_without_arguments_an_example_says_how_it_is_used(name):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / name], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"usage: python examples/{name} ")
    assert len(done.stderr.splitlines()) == 1


def test_signed_distance_of_a_box():
    import analytic
    import robot_collision

    model = analytic.model(analytic.slab((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)))
    distance, outward = robot_collision.signed_distance(model, np.array([[0, 0, 0.45], [0, 0, 0.55], [0.4, 0, 0]]))
    np.testing.assert_allclose(distance, [-0.05, 0.05, -0.1], atol=1e-5)
    np.testing.assert_allclose(outward, [[0, 0, 1], [0, 0, 1], [1, 0, 0]], atol=1e-5)
    points = robot_collision.capsule_points(np.zeros(3), np.array([0, 0, 1.0]), 0.2)
    to_axis = points - np.clip(points @ [0, 0, 1.0], 0, 1)[:, None] * np.array([0, 0, 1.0])
    np.testing.assert_allclose(np.linalg.norm(to_axis, axis=1), 0.2, atol=1e-12)


def test_torch_fit_pose(golden):
    import torch
    import torch_fit_pose

    from cndhf_codec import load

    model = load(golden / "encoded.cndhf")
    points = torch_fit_pose.surface_points(model, 400)
    centre, scale = np.array(model.info["centre"]), model.info["scale"]
    turned = torch_fit_pose.rotation(torch.tensor([0.1, -0.15, 0.08], dtype=torch.float64)).numpy()
    moved = (points - centre) @ turned.T + centre + scale * np.array([0.03, -0.02, 0.04])
    rotation, shift, left = torch_fit_pose.fit_pose(model, moved)
    back = (moved - centre) @ rotation.T + centre + shift
    before, after = (np.linalg.norm(p - points, axis=1).mean() / scale for p in (moved, back))
    assert after < 0.03 * before
    assert left < 0.002 * scale
