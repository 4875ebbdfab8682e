"""Uniting parts: volumes, areas, cavities, holes, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from dirty import CUBE, box, sheet, touching

from cndhf_codec.errors import MeshError
from cndhf_codec.mesh import unite as module
from cndhf_codec.mesh.lengths import Length
from cndhf_codec.mesh.prepare import AsGiven, prepare
from cndhf_codec.mesh.unite import United, united


def united_of(*meshes: trimesh.Trimesh, thicken: Length | None = None) -> tuple[trimesh.Trimesh, AsGiven, United]:
    made, what = united(prepare(trimesh.util.concatenate(list(meshes)), thicken), 0)
    mesh = trimesh.Trimesh(made.mesh.vertices, made.mesh.faces, process=False)
    assert mesh.is_watertight
    assert what.volume == pytest.approx(mesh.volume)
    return mesh, made, what


def test_faces_inside_are_gone():
    mesh, made, what = united_of(box(*CUBE), box([0, -0.25, -0.25], [1, 0.25, 0.25]))
    assert (what.before, what.after) == (2, 1)
    assert mesh.volume == pytest.approx(1 + 0.5 * 0.25)
    assert mesh.area == pytest.approx(6 + 4 * 0.5 * 0.5)  # the far end covers the hole that the bar makes
    assert made.assumptions == []
    # What the error is measured against is the solid.
    corners = made.reference[0][made.reference[1]]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(cross, axis=1).sum() / 2 * made.norm.scale**2 == pytest.approx(mesh.area)


def test_parts_within_others_and_parts_that_touch():
    mesh, _, what = united_of(box([-1] * 3, [1] * 3), box([-0.5] * 3, [0.5] * 3))
    assert (what.before, what.after, len(mesh.faces)) == (2, 1, 12)
    mesh, _, what = united_of(touching())
    assert mesh.volume == pytest.approx(1)
    assert mesh.area == pytest.approx(6)


def test_parts_that_do_not_overlap_stay():
    far = box([2, -0.5, -0.5], [3, 0.5, 0.5])
    mesh, made, what = united_of(box(*CUBE), far)
    assert (what.before, what.after) == (2, 2)
    assert len(mesh.faces) == 24
    assert made.extents == pytest.approx([3.5, 1, 1])


def test_a_cavity_stays_but_where_a_part_fills_it():
    shell, cavity = box([-1] * 3, [1] * 3), box([-0.5] * 3, [0.5] * 3, inverted=True)
    mesh, _, what = united_of(shell, cavity)
    assert (what.before, what.after) == (1, 1)
    assert mesh.volume == pytest.approx(8 - 1)
    # A bar through the wall fills half of the cavity; one beside it nothing.
    mesh, _, what = united_of(shell, cavity, box([0, -0.6, -0.6], [2, 0.6, 0.6]), box([0.8, 0.8, -3], [0.9, 0.9, 3]))
    assert (what.before, what.after) == (3, 1)
    assert mesh.volume == pytest.approx(8 - 0.5 + 1.2**2 + 4 * 0.1**2)


def test_a_hole_is_closed_and_said():
    open_box = box(*CUBE)
    keep = ~(open_box.triangles[:, :, 0] > 0.4).all(axis=1)
    keep[np.flatnonzero(~keep)[0]] = True  # half of one side is missing
    open_box.update_faces(keep)
    mesh, made, what = united_of(open_box, box([-0.75, -0.1, -0.1], [0, 0.1, 0.1]))
    assert what.after == 1
    assert mesh.volume == pytest.approx(1 + 0.25 * 0.04)
    assert any("what closes holes of the surface is" in line for line in made.assumptions)


def test_a_part_that_overlaps_itself_is_said():
    # One component, for the spike's tip is a corner of the box.
    spike = trimesh.convex.convex_hull([[0.5, 0.5, 0.5], [-1.5, 0.1, 0.2], [0.1, -1.5, 0.1], [0.2, 0.1, -1.5]])
    _, made, _ = united_of(box(*CUBE), spike)
    assert any("overlap themselves" in line for line in made.assumptions)


def test_sheets_have_no_inside_unless_they_get_a_wall():
    with pytest.raises(MeshError, match=r"it has no inside.*--thicken 1%"):
        united_of(sheet())
    mesh, _, what = united_of(sheet(), box([-0.2] * 3, [0.2] * 3), thicken=Length(0.05, relative=False))
    assert (what.before, what.after) == (2, 1)
    assert mesh.volume == pytest.approx(0.05 + 0.4**2 * (0.4 - 0.05) + 4 * np.pi * 0.025**2 / 2, rel=0.03)


def test_too_many_faces(monkeypatch):
    monkeypatch.setattr(module, "MOST_FACES", 11)
    with pytest.raises(MeshError, match="it has 12 faces; --solid unites at most 11: simplify it first"):
        united_of(box(*CUBE))
