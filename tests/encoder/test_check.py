"""`check` on known shapes, and that it agrees with `encode`."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
import trimesh
from dirty import CUBE, box, sheet, touching

import cndhf_codec
from cndhf_codec import check
from cndhf_codec.errors import InputError, MeshError, OptionError


def test_a_clean_mesh():
    found = check(trimesh.creation.box((2, 4, 6)))
    assert (found.faces, found.vertices, found.components) == (12, 8, 1)
    assert (found.boundary_loops, found.boundary_edges, found.nonmanifold_edges, found.dropped_faces) == (0, 0, 0, 0)
    assert (found.flipped, found.self_intersections, found.assumptions, found.refusal) == (0, 0, [], None)
    assert (found.hidden, found.error_lower_bound) == (0, 0)
    assert found.extents == (2, 4, 6)
    assert found.diagonal == pytest.approx(np.sqrt(56))
    assert found.volume == pytest.approx(48, rel=1e-3)


def test_it_is_plain_data():
    assert json.loads(json.dumps(asdict(check(box(*CUBE)))))["faces"] == 12
    assert isinstance(check(box(*CUBE)), cndhf_codec.Check)


def test_loops_and_edges():
    tube = trimesh.creation.cylinder(0.5, 3.0, sections=24)
    tube.update_faces(np.abs(tube.triangles_center[:, 2]) < 1.49)
    found = check(tube)
    assert (found.boundary_loops, found.boundary_edges) == (2, 48)
    found = check(touching())
    assert (found.components, found.nonmanifold_edges) == (1, 5)
    assert found.volume == pytest.approx(1, rel=1e-3)
    assert check(trimesh.util.concatenate([box(*CUBE), box([1] * 3, [2] * 3)])).components == 2


def test_orientation():
    found = check(box(*CUBE, inverted=True))
    assert found.flipped == 1
    assert found.volume == pytest.approx(1, rel=1e-3)
    assert len(found.assumptions) == 1


@pytest.mark.encode
def test_self_intersections():
    a, b = trimesh.creation.icosphere(3), trimesh.creation.icosphere(3)
    b.apply_translation([0.7, 0.1, 0.2])
    assert check(a).self_intersections == 0
    assert check(a.subdivide()).self_intersections == 0
    # The circle where they cross goes round each of them.
    assert 0.02 < check(trimesh.util.concatenate([a, b])).self_intersections < 0.2
    b.apply_translation([5, 0, 0])
    assert check(trimesh.util.concatenate([a, b])).self_intersections == 0


def test_what_is_hidden_and_what_it_costs():
    shell, cavity = box([-1] * 3, [1] * 3), box([-0.5] * 3, [0.5] * 3, inverted=True)
    found = check(trimesh.util.concatenate([shell, cavity]))
    assert found.hidden == pytest.approx(0.2, abs=0.01)  # 6 of 30
    # The cavity's walls are a half below the surface, in one of the two directions that the error is the mean of.
    assert found.error_lower_bound == pytest.approx(0.2 * 0.5 / 2, rel=0.1)
    assert found.assumptions == []
    assert any("hidden from every axis" in line for line in found.dhf_assumptions)


def test_what_would_be_refused():
    found = check(sheet())
    assert found.refusal is not None
    assert (found.volume, found.hidden, found.axes, found.error_lower_bound) == (None, None, None, None)
    assert (found.boundary_loops, found.boundary_edges) == (1, 32)
    walled = check(sheet(), thicken="0.5mm", unit="cm")
    assert walled.refusal is None
    assert walled.volume == pytest.approx(0.05, rel=0.1)
    assert walled.faces == 128  # of the input


def test_what_is_no_mesh(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        check(tmp_path / "gone.ply")
    with pytest.raises(MeshError, match="has no faces"):
        check((np.zeros((3, 3)), np.zeros((0, 3), int)))
    with pytest.raises(OptionError, match="thickness"):
        check(sheet(), thicken="thick")
