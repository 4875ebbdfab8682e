"""The commands: what they write and print, and that every failure is one line and an exit code."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import analytic
import numpy as np
import pytest
import trimesh
from normals import stored_normals
from places import ROOT

from cndhf_codec import cli, load

BIN = Path(sys.executable).parent


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
def fails(run, tmp_path):
    """Run a command that must fail with one line on stderr, nothing on stdout and no new file; return the line."""

    def fails(code: int, name: str, *arguments) -> str:
        before = sorted(os.listdir(tmp_path))
        got, out, err = run(name, *arguments)
        assert "Traceback" not in err
        assert err.startswith(f"cndhf-{name}: error: ")
        assert len(err.splitlines()) == 1
        assert (got, out) == (code, "")
        assert sorted(os.listdir(tmp_path)) == before
        return err

    return fails


@pytest.fixture
def model(golden) -> Path:
    return golden / "encoded.cndhf"


@pytest.fixture
def box(tmp_path) -> Path:
    trimesh.creation.box((1, 0.5, 0.25)).export(tmp_path / "box.ply")
    return tmp_path / "box.ply"


@pytest.mark.encode
@pytest.mark.usefixtures("tiny")
def test_encode_decode_info(run, box, tmp_path):
    target, mesh = tmp_path / "box.cndhf", tmp_path / "back.ply"
    options = ["--preset", "fast", "--representation", "dhf", "--source-name", "--seed", "3", "--threads", "1"]
    code, out, err = run("encode", box, target, *options)
    assert (code, err) == (0, "")
    assert f"{target}: {target.stat().st_size} bytes" in out
    assert "input: 1 part, volume 0.125; result: 1 part, volume 0.1" in out
    errors = r"mean error \S+ % of the diagonal, p99 \S+ %, maximum \S+ %, 1 piece, \d+ s"
    last = rf"{box.stat().st_size} bytes -> \d+ bytes \(0\.\d:1\), {errors}"
    assert re.fullmatch(last, out.splitlines()[-1]), out

    code, out, err = run("decode", target, mesh, "--resolution", "32")
    assert (code, err) == (0, "")
    back = trimesh.load(mesh, process=False)
    assert f"{mesh}: {len(back.faces)} triangles, watertight: yes, {back.body_count} piece" in out

    code, out, err = run("info", target)
    assert (code, err) == (0, "")
    assert f"{target}: {target.stat().st_size} bytes" in out
    assert "source box.ply" in out
    assert "measured error" in out


def test_info_as_json(run, model):
    code, out, err = run("info", model, "--json")
    info = json.loads(out)
    assert (code, err) == (0, "")
    assert info["bytes"] == model.stat().st_size
    assert info["parameters"] == sum(d["parameters"] for d in info["dhfs"])
    assert info["mean_error"] > 0


@pytest.mark.parametrize("extension", ["ply", "obj", "stl", "off", "glb", "PLY"])
def test_decode_to_every_extension(run, model, tmp_path, extension):
    target = tmp_path / f"a.{extension}"
    assert run("decode", model, target, "--resolution", "24")[0] == 0
    mesh = trimesh.load(target, process=False, force="mesh")
    if extension == "stl":
        mesh.merge_vertices()  # an STL has no shared vertices
    expected = load(model).to_mesh(24)
    assert mesh.is_watertight
    assert len(mesh.faces) == len(expected.faces)
    assert mesh.volume == pytest.approx(expected.volume, rel=1e-4)
    np.testing.assert_allclose(mesh.bounds, expected.bounds, atol=1e-4)


@pytest.mark.encode
def test_decode_by_intersection(run, model, tmp_path):
    fine, coarse = tmp_path / "fine.ply", tmp_path / "coarse.ply"
    assert run("decode", model, fine, "--method", "intersection", "--max-error", "0.1%")[0] == 0
    assert run("decode", model, coarse, "--method", "intersection", "--faces", "3000")[0] == 0
    meshes = [trimesh.load(path, process=False) for path in (fine, coarse)]
    assert all(mesh.is_watertight for mesh in meshes)
    assert 1500 < len(meshes[1].faces) <= 3000 < len(meshes[0].faces)
    assert meshes[0].volume == pytest.approx(load(model).to_mesh(64).volume, rel=0.01)


def test_a_fall_back_is_one_line(run, model, tmp_path, monkeypatch):
    from cndhf_codec.decoder.dhf import intersection
    from cndhf_codec.errors import SurfaceError

    def fail(*_):
        raise SurfaceError("manifold3d refuses the intersection (NotManifold)")

    monkeypatch.setattr(intersection, "intersection", fail)
    options = ["--method", "intersection", "--resolution", "16", "--quiet"]
    code, out, err = run("decode", model, tmp_path / "a.ply", *options)
    assert (code, out) == (0, "")
    assert err.startswith("cndhf-decode: warning: ")
    assert "marching cubes" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("extension", ["ply", "obj", "glb"])
def test_normals_are_written(run, model, tmp_path, extension):
    plain, target = tmp_path / f"plain.{extension}", tmp_path / f"a.{extension}"
    default = extension == "glb"
    assert run("decode", model, plain, "--resolution", "16", *["--no-normals"] * default)[0] == 0
    assert run("decode", model, target, "--resolution", "16", *["--normals"] * (not default))[0] == 0
    mesh = load(model).to_mesh(16, normals=True)
    assert target.stat().st_size > plain.stat().st_size + 10 * len(mesh.vertices)
    np.testing.assert_allclose(stored_normals(target), mesh.vertex_normals, atol=1e-4)


@pytest.mark.parametrize("extension", ["stl", "off"])
def test_formats_without_normals(fails, model, tmp_path, extension):
    assert "no vertex normals" in fails(2, "decode", model, tmp_path / f"a.{extension}", "--normals")


def test_decode_to_an_occupancy_grid(run, model, tmp_path):
    target = tmp_path / "grid.npz"
    code, out, err = run("decode", model, "--occupancy", target, "--resolution", "20")
    assert (code, err) == (0, "")
    assert "grid.npz" in out
    with np.load(target) as saved:
        assert sorted(saved.files) == ["occupancy", "origin", "spacing"]
        grid, origin, spacing = (saved[k] for k in ("occupancy", "origin", "spacing"))
    assert (grid.dtype, grid.ndim, origin.shape, spacing.shape) == (bool, 3, (3,), ())
    nodes = origin + spacing * np.stack(np.indices(grid.shape), axis=-1)
    assert (grid == load(model).contains(nodes)).mean() > 0.999  # at f = 0 float32 may differ
    assert (grid == load(model).contains(nodes + spacing / 2)).mean() < 0.98  # half a cell off would be seen


def test_decode_to_both(run, model, tmp_path):
    mesh, grid = tmp_path / "a.ply", tmp_path / "a.npz"
    assert run("decode", model, mesh, "--occupancy", grid, "--resolution", "16")[0] == 0
    assert mesh.exists()
    assert grid.exists()


@pytest.mark.parametrize("options", [[], ["--resolution", "48"], ["--method", "intersection", "--max-error", "0.3%"]])
def test_decode_to_levels_of_detail(run, fails, model, tmp_path, options):
    code, out, err = run("decode", model, tmp_path / "a.glb", "--lod", "3", *options)
    assert (code, err) == (0, "")
    assert sorted(os.listdir(tmp_path)) == ["a.lod0.glb", "a.lod1.glb", "a.lod2.glb"]
    assert len(out.splitlines()) == 3
    counts = [len(trimesh.load(path, force="mesh").faces) for path in sorted(tmp_path.iterdir())]
    assert counts[1] == pytest.approx(counts[0] / 4, abs=2)
    assert counts[2] == pytest.approx(counts[0] / 16, abs=2)
    # One level that exists stops all of them, before any work.
    (tmp_path / "a.lod0.glb").unlink()
    assert "a.lod1.glb: exists already" in fails(1, "decode", model, tmp_path / "a.glb", "--lod", "2")
    for n in ("0", "-1", "15"):
        assert f"--lod is {n}" in fails(2, "decode", model, tmp_path / "b.glb", "--lod", n)


@pytest.mark.parametrize("option", ["--embed", "--embed-only"])
def test_a_glb_carries_the_file(run, tmp_path, option):
    model, target = ROOT / "spec/vectors/dhf-sections.cndhf", tmp_path / "a.glb"  # with sections that nobody knows
    code, out, err = run("decode", model, target, option)
    assert (code, err) == (0, "")
    assert model.read_bytes() in target.read_bytes()
    if option == "--embed":
        faces = len(trimesh.load(target, process=False, force="mesh").faces)
        assert out.startswith(f"{target}: {faces} triangles, ")
        assert faces == len(load(model).to_mesh().faces)
    else:
        assert out == f"{target}: {target.stat().st_size} bytes, no mesh\n"
        assert target.stat().st_size < model.stat().st_size + 1024


def test_by_default_few_triangles_and_faces_for_every_method(run, model, tmp_path):
    out = run("decode", model, tmp_path / "a.ply")[1]
    assert ", watertight: yes, 1 piece" in out
    default = len(trimesh.load(tmp_path / "a.ply").faces)
    assert default < len(load(model).to_mesh(128).faces) / 5
    assert run("decode", model, tmp_path / "b.ply", "--faces", "300")[0] == 0
    assert len(trimesh.load(tmp_path / "b.ply").faces) == 300
    assert run("decode", model, tmp_path / "c.ply", "--max-error", "2%", "--specks")[0] == 0
    assert len(trimesh.load(tmp_path / "c.ply").faces) < 2 * default


@pytest.mark.encode
@pytest.mark.parametrize("extension", ["ply", "glb", "obj"])
def test_decode_from_and_to_a_stream(run, model, tmp_path, extension):
    code = "from cndhf_codec import cli; cli.decode()"
    command = [sys.executable, "-c", code, "-", "-", "--format", extension, "--resolution", "16"]
    done = subprocess.run(command, input=model.read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert run("decode", model, tmp_path / f"a.{extension}", "--resolution", "16")[0] == 0
    assert done.stdout == (tmp_path / f"a.{extension}").read_bytes()


ENCODE = [sys.executable, "-c", "from cndhf_codec import cli; cli.encode()"]


@pytest.mark.encode
def test_check_of_the_standard_input(box):
    for name in ("-", "/dev/stdin"):
        done = subprocess.run([*ENCODE, "--check", name], input=box.read_bytes(), capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        assert b": 12 faces, 8 vertices" in done.stdout
    done = subprocess.run([*ENCODE, "--check", "-"], input=b"<html></html>", capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")
    assert done.stderr.startswith(b"cndhf-encode: error: standard input: is a web page")


@pytest.mark.usefixtures("tiny")
def test_encode_from_and_to_a_stream(run, box, tmp_path, monkeypatch):
    options = ["--preset", "fast", "--seed", "3", "--threads", "1"]
    with open(box, "rb") as file:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(file))
        code, _, err = run("encode", "-", tmp_path / "a.cndhf", *options)
    assert (code, err) == (0, "")
    # What goes to the standard output is the file and nothing else.
    written = io.TextIOWrapper(io.BytesIO())
    monkeypatch.setattr("sys.stdout", written)
    code, _, err = run("encode", box, "-", *options)
    assert (code, err) == (0, "")
    assert written.buffer.getvalue() == (tmp_path / "a.cndhf").read_bytes()


@pytest.mark.usefixtures("tiny")
def test_no_output_replaces_its_input(fails, box, model, tmp_path):
    (tmp_path / "link").symlink_to(box)
    os.link(box, tmp_path / "twin")
    before = box.read_bytes()
    for target in (box, tmp_path / "link", tmp_path / "twin"):
        assert "is the input itself" in fails(1, "encode", box, target, "--overwrite", "--force-name")
    own = tmp_path / "own.ply"
    own.write_bytes(model.read_bytes())
    assert "is the input itself" in fails(1, "decode", own, own, "--overwrite")
    assert "is the input itself" in fails(1, "compare", box, box, "--html", box, "--overwrite")
    with open(box, "rb") as file:
        command = [*ENCODE, "-", box, "--overwrite", "--force-name"]
        done = subprocess.run(command, stdin=file, capture_output=True, text=True, check=False)
    assert "is the input itself" in done.stderr
    assert box.read_bytes() == before


@pytest.mark.parametrize("seed", ["-1", "99999999999"])
def test_check_refuses_seeds_as_encode_does(fails, box, seed):
    assert f"seed is {seed}" in fails(2, "encode", "--check", box, "--seed", seed)


@pytest.mark.encode
def test_a_stream_with_a_grid_beside_it_carries_the_mesh_only(model, tmp_path):
    code = "from cndhf_codec import cli; cli.decode()"
    options = ["--format", "off", "--resolution", "16", "--occupancy", tmp_path / "a.npz"]
    done = subprocess.run([sys.executable, "-c", code, model, "-", *options], capture_output=True, check=False)
    assert done.returncode == 0
    assert done.stdout.startswith(b"OFF")
    assert b"a.npz" in done.stderr
    assert b"a.npz" not in done.stdout


def test_damage_in_a_stream(tmp_path, model):
    code = "from cndhf_codec import cli; cli.decode()"
    command = [sys.executable, "-c", code, "-", tmp_path / "a.ply"]
    done = subprocess.run(command, input=model.read_bytes()[:-1], capture_output=True, text=False, check=False)
    assert (done.returncode, done.stdout) == (1, b"")
    assert done.stderr.startswith(b"cndhf-decode: error: standard input: the checksum does not match")
    assert not (tmp_path / "a.ply").exists()


def test_info_of_a_stream(run, model, monkeypatch):
    with open(model, "rb") as file:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(file))
        code, out, err = run("info", "-")
    assert (code, err) == (0, "")
    assert out == run("info", model)[1].replace(str(model), "standard input")


@pytest.mark.usefixtures("tiny")
def test_several_inputs_to_a_folder(run, box, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "broken.stl").write_text("no mesh")
    packed = tmp_path / "other.ply.gz"
    packed.write_bytes(gzip.compress(box.read_bytes()))
    paths = [tmp_path / "broken.stl", box, packed]
    code, out, err = run("encode", *paths, "--to", folder, "--preset", "fast", "--threads", "1")
    assert code == 1
    assert err.startswith(f"cndhf-encode: error: {tmp_path / 'broken.stl'}: ")
    assert len(err.splitlines()) == 1
    assert sorted(os.listdir(folder)) == ["box.cndhf", "other.cndhf"]
    assert out.count("1 piece") == 2
    assert "exists already" in run("encode", *paths, "--to", folder)[2]
    assert run("encode", box, folder / "a.bin", "--force-name", "--preset", "fast", "--quiet")[0] == 0
    assert load(folder / "a.bin").info["bytes"]


@pytest.mark.usefixtures("tiny")
def test_what_is_not_kept_is_named(run, tmp_path):
    text = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nv 0 0 1 1 0 0\nvt 0 0\nusemtl a\n"
    (tmp_path / "a.obj").write_text(text + "f 1/1 3/1 2/1\nf 1/1 2/1 4/1\nf 1/1 4/1 3/1\nf 2/1 3/1 4/1\n")
    out = run("encode", tmp_path / "a.obj", tmp_path / "a.cndhf", "--preset", "fast", "-v", "--representation", "dhf")[
        1
    ]
    assert "not kept: texture coordinates, materials, colours\n" in out
    assert "double height field" in out


def test_info_as_a_table(run, model):
    code, out, err = run("info", model)
    assert (code, err) == (0, "")
    rows = [line.split() for line in out.splitlines()]
    sections = {row[0]: int(row[1]) for row in rows if len(row) == 4 and row[3] == "%"}
    assert sorted(sections) == ["layout", "metadata", "records", "weights"]
    assert sum(sections.values()) == model.stat().st_size
    assert sum(row[:1] in (["0"], ["1"]) for row in rows) == len(load(model).container.dhfs)
    assert "bits each" in out


def test_info_of_a_file_that_was_not_measured(run, tmp_path):
    analytic.model(analytic.slab((-0.5,) * 3, (0.5,) * 3)).save(tmp_path / "a.cndhf")
    assert "error not measured" in run("info", tmp_path / "a.cndhf")[1]


def test_compare(run, box, tmp_path):
    other = trimesh.creation.box((1.02, 0.5, 0.25))
    other.export(tmp_path / "other.stl")
    code, out, err = run("compare", box, tmp_path / "other.stl")
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["mean", "p99", "maximum"]
    code, out, err = run("compare", box, tmp_path / "other.stl", "--json")
    values = json.loads(out)
    assert (code, err) == (0, "")
    assert values["max_error"] == pytest.approx(0.01, rel=0.01)
    assert values["percent"]["max_error"] == pytest.approx(1 / np.linalg.norm([1, 0.5, 0.25]), rel=0.01)


def test_a_page_needs_matplotlib_and_says_so_first(fails, box, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("cndhf_codec.report.compare.compare", lambda *_: pytest.fail("compared"))
    assert ".[report]" in fails(1, "compare", box, box, "--html", tmp_path / "a.html")


def test_compare_with_a_cndhf_file(run, model, tmp_path):
    load(model).to_mesh(32).export(tmp_path / "a.ply")
    code, out, err = run("compare", tmp_path / "a.ply", model, "--json", "--resolution", "32")
    assert (code, err) == (0, "")
    assert json.loads(out)["percent"]["max_error"] < 1e-3


@pytest.mark.encode
def test_compare_writes_a_page(run, fails, box, tmp_path, monkeypatch):
    from cndhf_codec.report import page

    monkeypatch.setattr(page, "SIZE", 64)
    assert run("compare", box, box, "--html", tmp_path / "a.html")[0] == 0
    assert (tmp_path / "a.html").read_text().count("data:image/png") == 3
    assert "exists already" in fails(1, "compare", box, box, "--html", tmp_path / "a.html")
    assert "gone.ply: no such file" in fails(1, "compare", box, tmp_path / "gone.ply")


def test_mesh_and_grid_are_two_files(fails, model, tmp_path):
    both = tmp_path / "a.ply"
    assert "cannot be one file" in fails(2, "decode", model, both, "--occupancy", both)
    assert "needs a file" in fails(2, "decode", model, "--occupancy", "-")
    assert not both.exists()


@pytest.mark.usefixtures("tiny")
def test_quiet(run, box, tmp_path):
    target, mesh, grid = tmp_path / "a.cndhf", tmp_path / "a.ply", tmp_path / "a.npz"
    assert run("encode", box, target, "--preset", "fast", "--quiet") == (0, "", "")
    options = ["--occupancy", grid, "--resolution", "16", "--quiet"]
    assert run("decode", target, mesh, *options) == (0, "", "")


@pytest.fixture
def cloth(tmp_path) -> Path:
    """A sheet that is open all round."""
    square = trimesh.creation.box((1, 1, 1)).subdivide()
    square.update_faces(square.triangles_center[:, 2] > 0.49)
    square.export(tmp_path / "cloth.ply")
    return tmp_path / "cloth.ply"


def test_check(run, box, tmp_path):
    code, out, err = run("encode", box, "--check")
    assert (code, err) == (0, "")
    assert out.startswith(f"{box}: 12 faces, 8 vertices, 1 component\n")
    assert out.endswith("would be encoded\n")
    out_of_check = out
    code, out, err = run("encode", "--check", "--json", box)
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert (found["faces"], found["refusal"], found["hidden"]) == (12, None, 0)
    assert found["volume"] == pytest.approx(0.125)
    assert "parts that do not touch: 1; volume: 0.125\n" in out_of_check
    assert "0.0 %" not in out_of_check
    assert os.listdir(tmp_path) == ["box.ply"]


def test_a_cloth_is_refused(run, fails, cloth, tmp_path):
    assert "cloth.ply: it has no inside" in fails(1, "encode", cloth, tmp_path / "a.cndhf", "--representation", "dhf")
    assert "a wall of 0.0001" in fails(1, "encode", cloth, tmp_path / "a.cndhf", "--thicken", "0.0001")
    code, out, err = run("encode", cloth, "--check", "--representation", "dhf")
    assert (code, err) == (1, "")
    assert "would be refused" in out
    assert "--thicken 1%" in out
    code, out, err = run("encode", cloth, "--check")
    assert (code, err) == (0, "")
    assert "would be encoded as a surface; not as double height fields: " in out
    assert run("encode", cloth, "--check", "--representation", "surface")[1].endswith("\nwould be encoded\n")
    code, out, err = run("encode", cloth, "--check", "--json", "--representation", "dhf")
    assert code == 1
    assert "no inside" in json.loads(out)["refusal"]
    assert run("encode", cloth, "--check", "--thicken", "2%")[0] == 0


def test_overlapping_parts_are_united(run, fails, cloth, tmp_path):
    parts = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((2, 0.5, 0.5))]
    trimesh.util.concatenate(parts).export(tmp_path / "parts.ply")
    options = ["--preset", "fast", "--representation", "surface", "--target-size", "1KiB"]
    target = tmp_path / "parts.cndhf"
    code, out, err = run("encode", tmp_path / "parts.ply", target, "--solid", *options)
    assert (code, err) == (0, "")
    assert "united: 2 parts became 1 part, volume 1.25\n" in out
    model = load(target)
    mesh = model.to_mesh()
    assert mesh.volume == pytest.approx(1.25, rel=0.01)
    assert mesh.area == pytest.approx(6 + 4 * 0.5, rel=0.01)  # without --solid it has the faces inside, too: 10.5
    code, out, err = run("encode", "--check", tmp_path / "parts.ply", "--solid")
    assert (code, err) == (0, "")
    assert "united: 2 parts became 1 part, volume 1.25\n" in out
    refusal = fails(1, "encode", cloth, tmp_path / "a.cndhf", "--solid")
    assert "cloth.ply: it has no inside" in refusal
    assert "--thicken 1%" in refusal


@pytest.mark.usefixtures("tiny")
def test_a_cloth_gets_a_wall(run, cloth, tmp_path):
    arguments = [
        cloth,
        tmp_path / "a.cndhf",
        "--preset",
        "fast",
        "--representation",
        "dhf",
        "--thicken",
        "5cm",
        "--unit",
        "m",
    ]
    code, _, err = run("encode", *arguments)
    assert code == 0
    assert "warning: sheets, 100.0 % of what is seen from outside, got a wall of 0.05" in err
    bounds = load(tmp_path / "a.cndhf").to_mesh(32).extents
    assert bounds[2] < 0.3


def test_decoding_to_an_stl_far_away_warns(run, tmp_path):
    from analytic import model as analytic_model
    from analytic import slab

    analytic_model(slab((-0.5, -0.5, -0.25), (0.5, 0.5, 0.25)), centre=(1e6, 0, 0)).save(tmp_path / "a.cndhf")
    code, _, err = run("decode", tmp_path / "a.cndhf", tmp_path / "a.stl", "--resolution", "16")
    assert code == 0
    assert "warning" in err
    assert "STL holds float32" in err
    assert run("decode", tmp_path / "a.cndhf", tmp_path / "a.ply", "--resolution", "16")[2] == ""
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(mesh.extents, [1, 1, 0.5], atol=1e-3)


@pytest.mark.usefixtures("tiny")
def test_warnings_stay_when_quiet(run, tmp_path):
    mesh = trimesh.creation.box((1, 0.5, 0.25))
    mesh.invert()
    mesh.export(tmp_path / "inverted.ply")
    code, out, err = run("encode", tmp_path / "inverted.ply", tmp_path / "a.cndhf", "--preset", "fast", "--quiet")
    assert (code, out) == (0, "")
    assert "100.0 % of the surface faced inward" in err


def test_existing_outputs_are_kept(fails, model, box, tmp_path):
    for name in ("a.ply", "a.npz", "a.cndhf"):
        (tmp_path / name).write_text("precious")
    for name, arguments in (
        ("decode", [model, tmp_path / "a.ply"]),
        ("decode", [model, "--occupancy", tmp_path / "a.npz"]),
        ("decode", [model, tmp_path / "new.ply", "--occupancy", tmp_path / "a.npz"]),
        ("encode", [box, tmp_path / "a.cndhf"]),
    ):
        assert "exists already; pass --overwrite" in fails(1, name, *arguments)
    assert {(tmp_path / n).read_text() for n in ("a.ply", "a.npz", "a.cndhf")} == {"precious"}


@pytest.mark.usefixtures("tiny")
def test_overwrite(run, model, box, tmp_path):
    for name in ("a.ply", "a.npz", "a.cndhf"):
        (tmp_path / name).write_text("old")
    arguments = [tmp_path / "a.ply", "--occupancy", tmp_path / "a.npz", "--resolution", "16", "--overwrite"]
    assert run("decode", model, *arguments)[0] == 0
    assert run("encode", box, tmp_path / "a.cndhf", "--preset", "fast", "--overwrite")[0] == 0
    load(tmp_path / "a.cndhf")
    assert trimesh.load(tmp_path / "a.ply").is_watertight


def test_missing_input(fails, tmp_path):
    gone = tmp_path / "gone"
    assert "gone.ply: no such file" in fails(1, "encode", f"{gone}.ply", tmp_path / "a.cndhf")
    assert "gone.cndhf: cannot be read" in fails(1, "decode", f"{gone}.cndhf", tmp_path / "a.ply")
    assert "gone.cndhf: cannot be read" in fails(1, "info", f"{gone}.cndhf")
    assert "Is a directory" in fails(1, "info", tmp_path)


def test_missing_folder(fails, model, box, tmp_path):
    assert "folder does not exist" in fails(1, "encode", box, tmp_path / "no" / "a.cndhf")
    assert "folder does not exist" in fails(1, "decode", model, tmp_path / "no" / "a.ply")
    assert "folder does not exist" in fails(1, "decode", model, "--occupancy", tmp_path / "no" / "a.npz")


def test_damaged_and_foreign_input(fails, model, box, tmp_path):
    damaged = tmp_path / "damaged.cndhf"
    damaged.write_bytes(model.read_bytes()[:-9])
    for name in ("decode", "info"):
        rest = [tmp_path / "a.ply"] if name == "decode" else []
        assert "damaged.cndhf: the checksum does not match" in fails(1, name, damaged, *rest)
        assert "box.ply: this is not a .cndhf file" in fails(1, name, box, *rest)
    assert "unknown mesh extension" in fails(1, "encode", model, tmp_path / "a.cndhf")


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("encode", [], "INPUT"),
        ("encode", ["a.ply"], "OUTPUT"),
        ("encode", ["a.ply", "a.cndhf", "--check"], "leave a.cndhf out"),
        ("encode", ["a.ply", "b.ply"], "does not end in .cndhf"),
        ("encode", ["a.ply", "b.cndhf", "c.ply"], "--to DIR"),
        ("encode", ["a.ply", "b.ply", "--to", "none"], "none: --to needs a folder"),
        ("encode", ["a.ply", "-", "--to", "."], "standard input has no name"),
        ("encode", ["a.ply", "sub/a.obj", "--to", "."], "same output as a.ply"),
        ("encode", ["a.ply", "a.cndhf", "--target-max", "1mm"], "state it with --unit"),
        ("encode", ["a.ply", "a.cndhf", "--target-max", "1%", "--target-size", "1KiB"], "no target size"),
        ("encode", ["a.ply", "a.cndhf", "--json"], "--json goes with --check"),
        ("encode", ["a.ply", "a.cndhf", "--thicken", "thick"], "thickness is 'thick'"),
        ("encode", ["a.ply", "--check", "--thicken", "2mm"], "state it with --unit"),
        ("encode", ["a.ply", "a.cndhf", "--preset", "slow"], "slow"),
        ("encode", ["a.ply", "a.cndhf", "--width", "wide"], "wide"),
        ("encode", ["a.ply", "a.cndhf", "--width", "3"], "width is 3"),
        ("encode", ["a.ply", "a.cndhf", "--axes", "0"], "axes is 0"),
        ("encode", ["a.ply", "a.cndhf", "--threads", "0"], "threads is 0"),
        ("encode", ["a.ply", "a.cndhf", "--seed", "-1"], "seed is -1"),
        ("encode", ["a.ply", "a.cndhf", "--frobnicate"], "--frobnicate"),
        ("decode", ["MODEL"], "nothing to write"),
        ("decode", ["MODEL", "a.step"], "unknown mesh extension"),
        ("decode", ["MODEL", "-"], "--format"),
        ("decode", ["MODEL", "a.ply", "--format", "obj"], "--format"),
        ("decode", ["MODEL", "-", "--format", "step"], "step"),
        ("decode", ["MODEL", "-", "--format", "ply", "--lod", "2"], "--lod"),
        ("decode", ["MODEL", "a.ply", "--faces", "100", "--max-error", "1%"], "not both"),
        ("decode", ["MODEL", "a.ply", "--embed"], "carries no .cndhf file"),
        ("decode", ["MODEL", "a.glb", "--embed", "--lod", "2"], "--embed needs one OUTPUT"),
        ("decode", ["MODEL", "--occupancy", "a.npz", "--embed"], "--embed needs one OUTPUT"),
        ("decode", ["MODEL", "a.glb", "--embed-only", "--faces", "100"], "writes no mesh"),
        ("decode", ["MODEL", "a.glb", "--embed-only", "--no-normals"], "writes no mesh"),
        ("compare", ["MODEL"], "B"),
        ("compare", ["MODEL", "MODEL", "--resolution", "7"], "resolution is 7"),
        ("decode", ["MODEL", "a.ply", "--resolution", "7"], "resolution is 7"),
        ("decode", ["MODEL", "a.ply", "--resolution", "many"], "many"),
        ("info", [], "INPUT"),
    ],
)
def test_wrong_arguments(fails, model, tmp_path, monkeypatch, name, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert message in fails(2, name, *(model if a == "MODEL" else a for a in arguments))


@pytest.mark.parametrize("name", ["encode", "decode", "info", "compare", "view"])
def test_help_and_version(run, name):
    code, out, err = run(name, "--help")
    assert (code, err) == (0, "")
    assert f"cndhf-{name}" in out
    assert run(name, "-h") == (code, out, err)
    code, out, err = run(name, "--version")
    assert (code, err) == (0, "")
    assert "0." in out


@pytest.mark.encode
@pytest.mark.parametrize(
    ("name", "gone", "extra"),
    [
        ("encode", "click", "encode"),
        ("decode", "click", "mesh"),
        ("info", "click", "cli"),
        ("compare", "click", "compare"),
        ("compare", "igl", "compare"),
        ("encode", "torch", "encode"),
        ("encode", "trimesh", "encode"),
        ("encode", "embreex", "encode"),
        ("decode", "trimesh", "mesh"),
    ],
)
def test_missing_extra(model, box, tmp_path, name, gone, extra):
    # In a fresh interpreter: nothing that this process has imported may stand in for the missing library.
    arguments = {"encode": [box, tmp_path / "a.cndhf"], "decode": [model, tmp_path / "a.ply"], "info": [model]}
    arguments = {**arguments, "compare": [box, box]}[name]
    code = f"import sys; sys.modules[{gone!r}] = None; from cndhf_codec import cli; cli.{name}()"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    expected = (
        f"cndhf-{name}: error: this needs {gone}, which is not installed; run, in a checkout of cndhf-codec: "
        f"pip install '.[{extra}]'"
    )
    assert done.stderr.splitlines() == [expected]


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("stage", ["read", "axes", "fit", "verify"])
def test_an_interrupt_leaves_nothing_behind(fails_by_interrupt, box, tmp_path, stage):
    fails_by_interrupt(stage, box, tmp_path / "a.cndhf")
    assert os.listdir(tmp_path) == ["box.ply"]


@pytest.fixture
def fails_by_interrupt(run, monkeypatch):
    from cndhf_codec.encoder.progress import Bar

    def fails(stage: str, *arguments) -> None:
        def interrupt(self, at, done, total, loss=float("nan")):
            if at == stage:
                raise KeyboardInterrupt

        monkeypatch.setattr(Bar, "__call__", interrupt)
        code, out, err = run("encode", *arguments, "--preset", "fast", "--representation", "dhf")
        assert (code, out) == (130, "")
        assert err.split() == ["cndhf-encode:", "error:", "interrupted;", "nothing", "was", "written"]

    return fails


@pytest.mark.parametrize("exception", [MemoryError(), OSError(28, "No space left on device")])
def test_other_failures_are_one_line_too(fails, monkeypatch, model, exception):
    import cndhf_codec.decoder.reading

    def fail(*_):
        raise exception

    monkeypatch.setattr(cndhf_codec.decoder.reading, "load_bytes", fail)
    fails(1, "info", model)


def test_a_reader_that_goes_away_is_no_traceback(model):
    # As `cndhf-info file | true`: the pipe is closed before the first line is written.
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [BIN / "cndhf-info", model], stdout=writer, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(writer)
    assert "Traceback" not in done.stderr
    assert done.returncode != 0


def test_text_that_the_terminal_cannot_show(tmp_path, golden):
    # The source name in this file has an umlaut; an ASCII terminal must not turn that into a failure.
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    done = subprocess.run(
        [BIN / "cndhf-info", golden / "by-hand.cndhf"], capture_output=True, env=environment, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"source Ger" in done.stdout


@pytest.mark.encode
def test_names_that_are_not_utf8(tmp_path, model):
    target = os.fsencode(tmp_path) + b"/\xff.ply"
    command = [os.fsencode(BIN / "cndhf-decode"), os.fsencode(model), target, b"--resolution", b"16"]
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}  # strict, as in most people's terminals
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert os.path.exists(target)


def test_text_in_a_file_cannot_drive_the_terminal(run, tmp_path):
    import rawfile

    data = rawfile.build([rawfile.fields(), (rawfile.SOURCE, b"a\x1b[2Jb\nfake line")])
    (tmp_path / "a.cndhf").write_bytes(data)
    code, out, _ = run("info", tmp_path / "a.cndhf")
    assert code == 0
    assert "\x1b" not in out
    assert "\nfake line" not in out


@pytest.mark.encode
@pytest.mark.parametrize("name", ["encode", "decode", "info"])
def test_the_installed_script(name, tmp_path):
    outputs = {"encode": [tmp_path / "a.cndhf"], "decode": [tmp_path / "a.ply"], "info": []}[name]
    done = subprocess.run(
        [BIN / f"cndhf-{name}", tmp_path / "no.cndhf", *outputs],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"cndhf-{name}: error: {tmp_path / 'no.cndhf'}: ")
    assert len(done.stderr.splitlines()) == 1
