"""Every vector of the specification, read by this package: to the values of the reference decoder.

A file that is missing or was changed is a failure: nothing here makes one. See tools/spec_vectors.py.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from places import ROOT

from cndhf_codec import load
from cndhf_codec.decoder.surface.levels import Level, next_level
from cndhf_codec.decoder.surface.normals import limit_normals, sectors_of
from cndhf_codec.decoder.surface.subdivision import topology_of
from cndhf_codec.errors import SheetError

FOLDER = ROOT / "spec" / "vectors"
EXPECTED = json.loads((FOLDER / "expected.json").read_text("utf-8"))
HEIGHTS = {name: wanted for name, wanted in EXPECTED.items() if "heights" in wanted}
SURFACES = {name: wanted for name, wanted in EXPECTED.items() if "faces" in wanted}
TOLERANCE = 1e-4  # of the specification, normalised units


def test_every_file_has_values_and_no_other():
    assert sorted(EXPECTED) == sorted(p.stem for p in FOLDER.glob("*.cndhf"))
    assert len(HEIGHTS) >= 12
    assert len(SURFACES) >= 19


@pytest.mark.parametrize("name", EXPECTED)
def test_what_is_stored(name):
    wanted = EXPECTED[name]
    path = FOLDER / f"{name}.cndhf"
    assert hashlib.sha256(path.read_bytes()).hexdigest() == wanted["sha256"]
    c = load(path).container
    assert [list(c.centre), c.scale] == [wanted["centre"], wanted["scale"]]
    m = c.metadata
    assert [m.encoder, m.source] == [wanted["encoder"], wanted["source"]]
    assert [m.mean_error, m.p99_error, m.max_error] == (wanted["errors"] or [None] * 3)
    assert len(c.dhfs) == len(wanted.get("heights", []))


@pytest.mark.parametrize("name", HEIGHTS)
def test_heights_and_f(name):
    wanted, model = HEIGHTS[name], load(FOLDER / f"{name}.cndhf")
    for i, heights in enumerate(wanted["heights"]):
        np.testing.assert_allclose(model.heights(i, wanted["uv"]), heights, atol=TOLERANCE, rtol=0)
    f = model.implicit(wanted["points"])
    np.testing.assert_allclose(f, wanted["f"], atol=TOLERANCE * model.container.scale, rtol=0)


@pytest.mark.parametrize("name", [name for name, wanted in EXPECTED.items() if "points" in wanted])
def test_inside(name):
    wanted = EXPECTED[name]
    assert set(wanted["contains"]) == {0, 1}
    found = load(FOLDER / f"{name}.cndhf").contains(wanted["points"])
    assert found.astype(int).tolist() == wanted["contains"]


@pytest.mark.parametrize("name", SURFACES)
def test_control_mesh(name):
    wanted, model = SURFACES[name], load(FOLDER / f"{name}.cndhf")
    mesh = model.container.surface
    assert mesh is not None
    assert [list(mesh.quaternion), mesh.step] == [wanted["quaternion"], wanted["step"]]
    assert mesh.positions.tolist() == wanted["positions"]
    assert mesh.faces.tolist() == wanted["faces"]
    assert mesh.sharp.tolist() == wanted["sharp"]
    if not wanted["solid"]:
        with pytest.raises(SheetError):
            model.contains([[0, 0, 0]])


@pytest.mark.parametrize("name", SURFACES)
def test_limit_points_and_normals(name):
    wanted, model = SURFACES[name], load(FOLDER / f"{name}.cndhf")
    c = model.container
    assert c.surface is not None
    mesh = c.surface
    level = Level(0, topology_of(mesh.faces, len(mesh.positions), mesh.sharp), mesh.vertices)
    for stored in wanted["levels"]:
        while level.number < stored["level"]:
            level = next_level(level)
        topology = level.topology
        n = len(topology.faces)
        assert n == stored["faces"]
        sectors = sectors_of(topology)
        normals = limit_normals(topology, level.vertices, level.limit, sectors)
        # Ours are the first of the four faces of each, then all the second: 4 f + k is k F + f, level by level.
        names = np.arange(len(mesh.faces))
        for _ in range(level.number):
            names = (4 * names + np.arange(4)[:, None]).ravel()
        place = np.argsort(names)
        for face, corner, *values in stored["corners"]:
            f = place[face]
            point = np.array(c.centre) + c.scale * level.limit[topology.faces[f, corner]]
            np.testing.assert_allclose(point, values[:3], atol=1e-6 * c.scale, rtol=0)
            np.testing.assert_allclose(normals[sectors.corners[f, corner]], values[3:], atol=1e-6)
