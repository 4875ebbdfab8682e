"""The commands on files that hold surfaces."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
import surfaces
import trimesh
from normals import stored_normals

from cndhf_codec import cli


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command in this process: (exit code, stdout, stderr)."""

    def run(name: str, *arguments) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", [f"cndhf-{name}", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            getattr(cli, name)()
        out, err = capsys.readouterr()
        return caught.value.code, out, err

    return run


@pytest.fixture
def files(tmp_path):
    for name in ("ball", "cube", "sheet"):
        getattr(surfaces, name)(centre=(1.0, 2.0, 3.0), scale=10.0).save(tmp_path / f"{name}.cndhf")
    return tmp_path


def test_decode_by_level_error_and_faces(run, files):
    for options, faces in (
        (("--level", 2), 128),
        (("--faces", 600), 600),
        (("--faces", 512), 512),
        (("--faces", 4), 4),
        (("--max-error", "0.02%"), 8192),
        ((), 8144),
    ):
        code, out, _ = run("decode", files / "ball.cndhf", files / "ball.ply", "--overwrite", *options)
        assert code == 0
        assert f"{faces} triangles, watertight: yes, 1 piece" in out
        assert len(trimesh.load(files / "ball.ply").faces) == faces
    mesh = trimesh.load(files / "ball.ply")
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), (1, 2, 3), atol=1e-4)


def test_decode_with_normals_keeps_edges_sharp(run, files):
    code, out, _ = run("decode", files / "cube.cndhf", files / "cube.ply", "--normals")
    assert code == 0
    assert "12 triangles, watertight: yes" in out
    assert np.abs(stored_normals(files / "cube.ply")).max(axis=1) == pytest.approx(1)


def test_levels_of_detail_have_a_quarter_of_the_triangles_each(run, files):
    code, _, _ = run("decode", files / "sheet.cndhf", files / "sheet.glb", "--lod", 2, "--level", 1)
    assert code == 0
    assert [len(trimesh.load_mesh(files / f"sheet.lod{k}.glb").faces) for k in range(2)] == [288, 72]
    code, _, _ = run("decode", files / "ball.cndhf", files / "ball.glb", "--lod", 4, "--faces", 400)
    assert code == 0
    assert [len(trimesh.load_mesh(files / f"ball.lod{k}.glb").faces) for k in range(4)] == [400, 100, 24, 6]
    code, _, err = run("decode", files / "ball.cndhf", files / "more.glb", "--lod", 4, "--level", 2)
    assert code == 2
    assert "the last level would have 2 triangles" in err
    assert not list(files.glob("more*"))


def test_a_grid_beside_a_mesh(run, files):
    grid = files / "grid.npz"
    code, _, _ = run("decode", files / "cube.cndhf", files / "c.stl", "--occupancy", grid, "--resolution", 16)
    assert code == 0
    with np.load(grid) as stored:
        assert stored["occupancy"].sum() * stored["spacing"] ** 3 == pytest.approx(1000, rel=0.2)


@pytest.mark.parametrize(
    ("name", "options", "code", "line"),
    [
        ("ball", ("b.ply", "--resolution", 64), 2, "this file holds a surface"),
        ("ball", ("b.ply", "--method", "intersection"), 2, "this file holds a surface"),
        ("ball", ("b.ply", "--level", 7), 2, "0 to 6"),
        ("ball", ("b.ply", "--faces", 3), 2, "4 or more"),
        ("sheet", ("b.ply", "--faces", 5), 2, "too few for this shape"),
        ("sheet", ("--occupancy", "b.npz"), 1, "--thicken"),
    ],
)
def test_what_is_refused_is_one_line(run, files, monkeypatch, name, options, code, line):
    monkeypatch.chdir(files)
    found, out, err = run("decode", f"{name}.cndhf", *options)
    assert (found, out) == (code, "")
    assert line in err
    assert err.count("\n") == 1
    assert not list(files.glob("b.*"))


def test_double_height_fields_have_no_levels(run, golden, tmp_path):
    code, _, err = run("decode", golden / "encoded.cndhf", tmp_path / "b.ply", "--level", 2)
    assert code == 2
    assert "level belongs to surfaces" in err


def test_info(run, files):
    code, out, _ = run("info", files / "cube.cndhf")
    assert code == 0
    assert "surface of 1 component, closed" in out
    assert "8 vertices, 12 faces, 18 sharp edges" in out
    assert "open: a sheet" in run("info", files / "sheet.cndhf")[1]
    values = json.loads(run("info", files / "cube.cndhf", "--json")[1])
    assert values["representation"] == "surface"
    assert "dhfs" not in values


def test_compare(run, files):
    run("decode", files / "ball.cndhf", files / "ball.stl", "--level", 5)
    code, out, _ = run("compare", files / "ball.stl", files / "ball.cndhf", "--json")
    assert code == 0
    assert json.loads(out)["percent"]["max_error"] < 0.02
    code, _, err = run("compare", files / "ball.stl", files / "ball.cndhf", "--resolution", 64)
    assert code == 2
    assert "holds a surface" in err
