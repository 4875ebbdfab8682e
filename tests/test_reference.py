"""The reference decoder: it agrees with every vector, and is what it says of itself: one file, on its own."""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

SPEC = ROOT / "spec"
sys.path.append(str(SPEC))

import reference  # noqa: E402

VECTORS = SPEC / "vectors"
EXPECTED = json.loads((VECTORS / "expected.json").read_text("utf-8"))


def test_it_is_one_file_and_shares_no_code():
    (path,) = SPEC.glob("*.py")
    text = path.read_text("utf-8")
    assert len(text.splitlines()) <= 660
    imported = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module)
    allowed = sys.stdlib_module_names | {"numpy", "zstandard"}
    assert {name.split(".")[0] for name in imported} <= allowed


@pytest.mark.parametrize("name", EXPECTED)
def test_vector(name):
    wanted = EXPECTED[name]
    data = (VECTORS / f"{name}.cndhf").read_bytes()
    assert hashlib.sha256(data).hexdigest() == wanted["sha256"]
    shape = reference.decode(data)
    assert shape["centre"].tolist() == wanted["centre"]
    for key in ("scale", "encoder", "source", "errors"):
        assert shape[key] == wanted[key]
    if "dhfs" in shape:
        for dhf, heights in zip(shape["dhfs"], wanted["heights"], strict=True):
            np.testing.assert_allclose(reference.heights(dhf, wanted["uv"]), heights, atol=1e-8)
        f = reference.implicit(shape, wanted["points"])
        np.testing.assert_allclose(f, wanted["f"], atol=1e-8 * shape["scale"])
        assert (f > 0).astype(int).tolist() == wanted["contains"]
        return
    mesh = shape["mesh"]
    stored = json.loads(json.dumps({key: mesh[key] for key in ("quaternion", "step", "positions", "faces", "sharp")}))
    assert stored == {key: wanted[key] for key in stored}
    assert reference.is_solid(mesh) == wanted["solid"]
    level = reference.Level(reference.control_vertices(mesh), mesh["faces"], mesh["sharp"])
    for number in range(len(wanted["levels"])):
        corners = wanted["levels"][number]["corners"]
        points, normals = shape["centre"] + shape["scale"] * level.limit(), level.normals()
        names = np.arange(len(mesh["faces"]))
        for _ in range(number):
            names = (4 * names + np.arange(4)[:, None]).ravel()
        for face, corner, *values in corners:
            f = int(np.flatnonzero(names == face)[0])
            np.testing.assert_allclose(points[level.faces[f][corner]], values[:3], atol=1e-8 * shape["scale"])
            np.testing.assert_allclose(normals[f, corner], values[3:], atol=1e-6)
        level = level.next()
    if wanted["solid"]:
        vertices = level.limit()
        for point, inside in zip(wanted["points"], wanted["contains"], strict=True):
            at = (np.array(point) - shape["centre"]) / shape["scale"]
            assert (reference.winding(vertices, level.faces, at) > 0.5) == inside


def test_the_files_that_the_specification_prints():
    blocks = (SPEC / "cndhf.md").read_text("utf-8").split("```")[1::2]
    fields, surface = (
        reference.decode(b"".join(bytes.fromhex(line.split("  ")[0]) for line in block.strip().splitlines()))
        for block in blocks
    )
    assert reference.heights(fields["dhfs"][0], [[0, 0]]).round(6).tolist() == [[-0.468163, 0.468163]]
    assert surface["mesh"]["positions"] == [(0, 0, 64), (52, -30, -21), (0, 60, -21), (-52, -30, -21)]
    assert surface["mesh"]["sharp"] == [(0, 2), (1, 2)]


@pytest.mark.parametrize("path", sorted(VECTORS.glob("refused/*.cndhf")), ids=lambda p: p.stem)
def test_refused(path: Path):
    with pytest.raises(reference.RefusedError):
        reference.decode(path.read_bytes())


@pytest.mark.parametrize("path", sorted(VECTORS.glob("accepted/*.cndhf")), ids=lambda p: p.stem)
def test_accepted(path: Path):
    tensors = reference.decode((VECTORS / "accepted/valid.cndhf").read_bytes())["dhfs"][0]["tensors"]
    (dhf,) = reference.decode(path.read_bytes())["dhfs"]
    assert all(np.array_equal(a, b) for a, b in zip(dhf["tensors"], tensors, strict=True))
