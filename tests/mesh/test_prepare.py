"""Preparing a source: what is refused, what gets a wall, and what is reported."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from dirty import CUBE, box, is_closed_and_outward, sheet
from quietly import encode_quietly

from cndhf_codec import encode
from cndhf_codec.errors import MeshError, OptionError
from cndhf_codec.mesh import prepare as module
from cndhf_codec.mesh.lengths import Length
from cndhf_codec.mesh.prepare import prepare


def flagged_box() -> trimesh.Trimesh:
    """A cube with a sheet standing on it, 1/5 of its size and 1/20 of its area."""
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
        encode(path, representation="dhf")


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
        "sheets without thickness, 5.7 % of the surface, between (-0.3, 0, 0.5) and (0.3, 0, 1.1), "
        "were left out; --thicken gives them a wall"
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
    shell, inner = box([-1] * 3, [1] * 3, inverted=True), box([-0.5] * 3, [0.5] * 3)  # a hollow box, inside out
    model, report = encode_quietly(trimesh.util.concatenate([shell, inner]), preset="fast", representation="dhf")
    assert report.visible == pytest.approx(0.8, abs=0.02)
    assert report.flipped == pytest.approx(1)
    assert [line.split(" % ")[1] for line in report.warnings[:2]] == [
        "of the surface faced inward and was turned round",
        "of the surface is hidden from every axis (cavities, inner parts) and comes back filled",
    ]
    assert report.distances.mean > 0
    assert (report.bodies.parts, report.bodies.minor, report.decoded.parts) == (1, 0, 1)
    assert report.bodies.volume == pytest.approx(7, rel=5e-3)
    assert report.decoded.volume == pytest.approx(model.to_mesh(32).volume)


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


def with_stray(*strays: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate([trimesh.creation.icosphere(3), *strays])


def speck(size: float, at: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.box([size] * 3)
    mesh.apply_translation([at, 0, 0])
    return mesh


def test_a_speck_far_away_does_not_decide_the_frame():
    triangle = trimesh.Trimesh([[200, 0, 0], [200.1, 0, 0], [200, 0.1, 0]], [[0, 1, 2]], process=False)
    for stray, faces in ((triangle, 1), (speck(0.01, -200), 12)):
        prepared = prepare(with_stray(stray))
        assert prepared.norm.scale == pytest.approx(1, rel=1e-3)
        assert len(prepared.solid.faces) == len(prepared.reference[1]) == len(trimesh.creation.icosphere(3).faces)
        assert prepared.diagonal < 4
        (line,) = prepared.assumptions
        assert line.startswith(f"1 tiny part far away ({faces} face")
        assert "200" in line
        assert prepared.refusal is None


def test_specks_nearby_and_parts_far_away_stay():
    for stray in (speck(0.01, 1.5), speck(1, 20), speck(1, 200)):
        prepared = prepare(with_stray(stray))
        assert prepared.assumptions == []
        assert len(prepared.solid.faces) == len(trimesh.creation.icosphere(3).faces) + 12
    # Many equal ones are the shape, however far apart.
    assert prepare(trimesh.util.concatenate([speck(0.01, 5 * k) for k in range(2000)])).assumptions == []


def test_the_frame_is_that_of_what_is_kept():
    flag = sheet().apply_scale(0.8).apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    mesh = trimesh.util.concatenate([box(*CUBE), flag.apply_translation([0, 0, 1.5])])
    prepared = prepare(mesh)
    assert prepared.refusal is None
    assert prepared.norm.scale == pytest.approx(np.sqrt(0.75), rel=1e-3)
    (line,) = prepared.assumptions
    assert "between (-0.4, " in line
    assert ", 1.9)" in line
    # The error is still measured against everything.
    vertices, faces = prepared.reference
    assert len(faces) == 12 + len(flag.faces)
    top = vertices.max(axis=0)[2] * prepared.norm.scale + prepared.norm.centre[2]
    assert top == pytest.approx(1.9)


@pytest.mark.parametrize("thickness", [1e-5, 1e-7])
def test_what_is_too_thin_for_a_file_is_refused(thickness):
    refusal = prepare(trimesh.creation.box((1, 1, thickness))).refusal
    assert refusal is not None
    assert "thinner than a file can tell" in refusal
    assert prepare(trimesh.creation.box((1, 1, 1e-3))).refusal is None


def test_nothing_is_called_turned_of_a_sheet():
    cloth = sheet()
    cloth.faces[::2] = cloth.faces[::2][:, ::-1]
    assert not any("turned" in line for line in prepare(cloth).assumptions)
    assert prepare(cloth).flipped == 0


def test_small_shares_are_not_called_none():
    assert [module.percent(x) for x in (0, 1e-5, 0.001, 0.5)] == ["0.0 %", "under 0.1 %", "0.1 %", "50.0 %"]


def test_notes_of_the_file_are_told(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box().export(path)
    path.write_bytes(path.read_bytes() + b"tail")
    assert any("4 bytes behind them" in line for line in prepare(path).assumptions)
