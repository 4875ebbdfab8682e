"""From a source to its solid: what is refused, what gets a wall, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from test_repair import CUBE, box, is_closed_and_outward, sheet

from cndhf_codec import encode
from cndhf_codec.encoder import prepare as module
from cndhf_codec.encoder.goal import Length
from cndhf_codec.encoder.pipeline import encode_with_report
from cndhf_codec.encoder.prepare import prepare
from cndhf_codec.errors import MeshError, OptionError


def flagged_box() -> trimesh.Trimesh:
    """A cube with a sheet of a fifth of its size standing on it, a twentieth of its area."""
    flag = sheet()
    flag.apply_scale(0.6)
    flag.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    flag.apply_translation([0, 0, 0.5 + 0.3])
    return trimesh.util.concatenate([box(*CUBE), flag])


def test_a_sheet_is_refused_with_the_remedy(tmp_path):
    path = tmp_path / "cloth.ply"
    sheet().export(path)
    refusal = prepare(path).refusal
    assert refusal is not None
    assert refusal.startswith(f"{path}: it has no inside")
    assert "--thicken 1%" in refusal
    assert "\n" not in refusal
    with pytest.raises(MeshError, match="it has no inside"):
        encode(path)


@pytest.mark.parametrize(("place", "size"), [(0, 1), (1e6, 1), (0, 1e-4), (0, 1e6)])
def test_a_wall_of_the_thickness_asked_for(place, size):
    square, thickness = sheet(), 0.05 * size
    prepared = prepare((square.vertices * size + place, square.faces), Length(thickness, relative=False))
    assert prepared.refusal is None
    assert any("got a wall" in line for line in prepared.assumptions)
    # The square's prism, a half cylinder along each side, and a quarter of a ball at each corner.
    r = 0.025
    volume = 0.05 + 4 * np.pi * r**2 / 2 + 4 * np.pi * r**3 / 3
    vertices, faces = prepared.reference
    vertices = vertices * prepared.norm.scale + np.array(prepared.norm.centre)
    walls = trimesh.Trimesh((vertices - place) / size, faces, process=False)
    assert walls.is_watertight
    assert walls.volume == pytest.approx(volume, rel=0.02)
    np.testing.assert_allclose(walls.bounds, [[-0.5 - r, -0.5 - r, -r], [0.5 + r, 0.5 + r, r]], atol=2e-3)
    assert prepared.solid.open == 0
    assert prepared.diagonal == pytest.approx(np.sqrt(2) * size)


def test_a_wall_relative_to_the_diagonal():
    prepared = prepare(sheet(), Length(0.02, relative=True))
    extent = np.ptp(prepared.solid.vertices, axis=0) * prepared.norm.scale
    assert extent[2] == pytest.approx(0.02 * np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("share", [0.004, 0.3])
def test_walls_that_cannot_be_made(share):
    with pytest.raises(MeshError, match=r"0\.5 % to 20 % can be made: --thicken 0\.00707 to 0\.283"):
        prepare(sheet(), Length(share, relative=True))


def test_a_thickness_that_is_none():
    with pytest.raises(OptionError, match="thickness is '-1'"):
        encode(sheet(), thicken="-1")


def test_a_solid_with_a_sheet_keeps_its_solid():
    mesh = flagged_box()
    plain = prepare(mesh)
    assert plain.refusal is None
    assert plain.assumptions == [
        "sheets without thickness, 5.7 % of the surface, were left out; --thicken gives them a wall"
    ]
    assert is_closed_and_outward(plain.solid, plain.norm.scale**-3)
    assert len(plain.reference[1]) == len(mesh.faces)  # the error tells of what was left out
    walled = prepare(mesh, Length(0.06, relative=False))
    assert walled.solid.open == 0
    on_flag = np.array([[0.1, 0.0, 0.9], [0.1, 0.025, 0.9], [0.1, 0.04, 0.9], [0.49, 0.49, 0.49], [0.51, 0, 0]])
    assert walled.solid.contains(walled.norm.apply(on_flag)).tolist() == [True, True, False, True, False]


def test_a_closed_mesh_gets_no_wall():
    prepared = prepare(box(*CUBE), Length(0.05, relative=True))
    assert is_closed_and_outward(prepared.solid, prepared.norm.scale**-3)
    assert prepared.assumptions == ["the surface has no sheets: nothing was thickened"]


def test_a_clean_mesh_needs_no_assumptions():
    prepared = prepare(trimesh.creation.icosphere(3))
    assert (prepared.assumptions, prepared.refusal, prepared.flipped) == ([], None, 0)


def test_every_assumption_is_said():
    good = trimesh.creation.icosphere(3)
    holed = trimesh.Trimesh(good.vertices, good.faces[good.triangles_center[:, 2] < 0.93], process=False)
    inverted = holed.copy()
    inverted.invert()
    faces = np.concatenate([inverted.faces, inverted.faces[:7], [[0, 0, 1]]])
    lines = prepare((inverted.vertices, faces)).assumptions
    for start in ("100.0 % of the surface faced inward", "7 faces were copies", "1 faces of zero area"):
        assert any(line.startswith(start) for line in lines)
    assert any("came in through a hole" in line for line in lines)
    both = trimesh.util.concatenate([good, trimesh.Trimesh(good.vertices, good.faces[:, ::-1])])
    assert prepare(both).assumptions == ["100.0 % of the surface was given in both orientations and is taken once"]


def test_the_error_is_measured_against_the_input_as_given():
    doubled = trimesh.util.concatenate([box(*CUBE), box(*CUBE, inverted=True), box([-0.2] * 3, [0.2] * 3)])
    prepared = prepare(doubled)
    assert len(prepared.solid.faces) == 24
    assert len(prepared.reference[1]) == 36


@pytest.mark.usefixtures("tiny")
def test_the_report_says_what_was_assumed_hidden_and_measured():
    shell, inner = box([-1] * 3, [1] * 3, inverted=True), box([-0.5] * 3, [0.5] * 3)
    report = encode_with_report(trimesh.util.concatenate([shell, inner]), "fast")[1]
    assert report.visible == pytest.approx(0.8, abs=0.02)
    assert report.flipped == pytest.approx(0.8)
    assert [line.split(" % ")[1] for line in report.warnings] == [
        "of the surface faced inward and was turned round",
        "of the surface is hidden from every axis (cavities, inner parts) and comes back filled",
    ]
    assert report.distances.chamfer > 0


def test_very_large_meshes_are_simplified_for_the_fit(monkeypatch):
    monkeypatch.setattr(module, "MOST_FACES", 5000)
    monkeypatch.setattr(module, "SIMPLIFIED", 2000)
    ball = trimesh.creation.icosphere(5, 3.0)
    ball.apply_translation([100, 0, 0])
    prepared = prepare(ball)
    assert len(prepared.solid.faces) <= 2000
    np.testing.assert_allclose(np.linalg.norm(prepared.solid.vertices, axis=1), 1, atol=5e-3)
    assert len(prepared.reference[1]) == len(ball.faces)
    assert "simplified from 20480" in prepared.assumptions[0]
