"""Edge collapses: how many faces are left, what stays exact, and which parts go first."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from control_meshes import square
from shapes import lumps

from cndhf_codec.encoder.surface.simplify import Simplified, Simplifier
from cndhf_codec.mesh.distances import surface_distances


def simplified(mesh: trimesh.Trimesh, n_faces: int) -> Simplified:
    return Simplifier.of(np.array(mesh.vertices), np.array(mesh.faces)).to(n_faces)


@pytest.mark.parametrize("n", [639, 501, 100, 20])
def test_the_number_of_faces_is_reached(n):
    out = simplified(lumps(), n)
    assert n - 2 <= len(out.faces) <= n
    assert (np.sort(np.unique(out.faces)) == np.arange(len(out.vertices))).all()


def test_no_face_has_a_vertex_twice():
    simplifier = Simplifier.of(np.array(lumps().vertices), np.array(lumps().faces))
    for n in (400, 100, 30, 8, 4):
        faces = simplifier.to(n).faces
        assert (faces != np.roll(faces, 1, axis=1)).all()


def test_a_plane_keeps_its_outline():
    out = simplified(square(12), 2)
    assert len(out.faces) == 2
    flat = trimesh.Trimesh(*out, process=False)
    assert flat.area == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(flat.bounds, [[0, 0, 0], [1, 1, 0]], atol=1e-5)


def test_a_cube_comes_down_to_its_12_faces_exactly():
    cube = trimesh.creation.box()
    for _ in range(4):
        cube = cube.subdivide()
    out = trimesh.Trimesh(*simplified(cube, 12), process=False)
    assert len(out.faces) == 12
    assert out.is_watertight
    assert out.volume == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(np.sort(out.vertices, axis=0), np.repeat([[-0.5] * 3, [0.5] * 3], 4, axis=0), atol=1e-5)


def test_the_error_falls_with_the_number_of_faces():
    sphere = trimesh.creation.icosphere(5)
    errors = []
    for n in (50, 200, 800, 3200):
        vertices, faces = simplified(sphere, n)
        errors.append(surface_distances(sphere.vertices, sphere.faces, vertices, faces, samples=10_000).mean)
    # Flat faces of area 1 / n are 1 / n off.
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 3) & (ratios < 6)).all()


def test_a_speck_vanishes_before_a_large_part_collapses():
    large, speck = trimesh.creation.icosphere(3), trimesh.creation.icosphere(2, 0.01)
    speck.apply_translation((3, 0, 0))
    out = trimesh.Trimesh(*simplified(trimesh.util.concatenate([large, speck]), 100), process=False)
    assert out.vertices[:, 0].max() < 1.2
    assert out.is_watertight
    assert out.volume == pytest.approx(large.volume, rel=0.05)


def test_a_sheet_vanishes_too():
    large, speck = trimesh.creation.icosphere(3), square(4)
    speck.apply_scale(0.01)
    speck.apply_translation((3, 0, 0))
    out = trimesh.Trimesh(*simplified(trimesh.util.concatenate([speck, large]), 100), process=False)
    assert out.vertices[:, 0].max() < 1.2
    assert out.is_watertight


def test_a_part_that_touches_another_goes_alone():
    # A needle stands with its point on a sphere: a collapse along it would turn its base over, so it goes as a whole.
    # The sphere's faces at the point must stay.
    large = trimesh.creation.icosphere(3)
    top = int(np.argmax(large.vertices[:, 2]))
    new = large.vertices[top] + 1e-4 * np.array([(0.1, 0, 1), (-0.1, 0.1, 1), (-0.1, -0.1, 1)])
    n = len(large.vertices)
    a, b, c = n, n + 1, n + 2
    faces = np.concatenate([large.faces, [(top, b, a), (top, c, b), (top, a, c), (a, b, c)]])
    out = Simplifier.of(np.concatenate([large.vertices, new]), faces).to(len(large.faces))
    left = trimesh.Trimesh(*out, process=False)
    assert len(out.faces) == len(large.faces)
    assert left.is_watertight
    assert left.volume == pytest.approx(large.volume, rel=1e-3)


def test_each_call_goes_on_where_the_last_stopped():
    simplifier = Simplifier.of(np.array(lumps().vertices), np.array(lumps().faces))
    first = simplifier.to(600)
    assert len(simplifier.to(700).faces) == len(first.faces)
    assert len(simplifier.to(200).faces) <= 200


def test_it_repeats_and_leaves_its_input_alone():
    mesh = lumps()
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    kept = vertices.copy(), faces.copy()
    one, other = Simplifier.of(vertices, faces).to(300), Simplifier.of(vertices, faces).to(300)
    assert one.vertices.tobytes() == other.vertices.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()
    np.testing.assert_array_equal(vertices, kept[0])
    np.testing.assert_array_equal(faces, kept[1])


def test_the_seam_of_a_moebius_strip_collapses_like_other_edges():
    """Faces on both sides of the seam go along it the same way."""
    angle = np.linspace(0, np.pi, 13)[:-1]
    across = np.array([-0.2, 0, 0.2])[:, None]
    x = (1 + across * np.cos(angle)) * np.cos(2 * angle)
    y = (1 + across * np.cos(angle)) * np.sin(2 * angle)
    vertices = np.stack([x, y, across * np.sin(angle)], axis=-1).transpose(1, 0, 2).reshape(-1, 3)
    # Twelve columns of three; the last joins the first upside down.
    faces = []
    for i in range(12):
        for j in range(2):
            a, b = 3 * i + j, 3 * i + j + 1
            c, d = (3 * i + 3 + j, 3 * i + 4 + j) if i < 11 else (2 - j, 1 - j)
            faces += [(a, c, b), (b, c, d)]
    from cndhf_codec.encoder.surface.simplify import _edges_by_cost, _start

    strip = np.array(faces)
    edges = {(min(u, v), max(u, v)) for u, v in np.concatenate([strip[:, [k, (k + 1) % 3]] for k in range(3)]).tolist()}
    found = [(min(u, v), max(u, v)) for _, u, v, _ in _edges_by_cost(_start(vertices, strip))]
    assert set(found) == edges
