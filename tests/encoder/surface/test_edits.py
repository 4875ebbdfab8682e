"""Edits of the control mesh: what they gain, and what they must leave as it is."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
import trimesh
from control_meshes import arrays, smooth_fit, square, target_of

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.surface import edits
from cndhf_codec.encoder.surface.creases import Fitted, fit_with_creases
from cndhf_codec.encoder.surface.cut import Manifold, cut
from cndhf_codec.encoder.surface.edits import Edited, edited
from cndhf_codec.encoder.surface.simplify import Simplifier
from cndhf_codec.encoder.surface.target import Target

pytestmark = pytest.mark.encode

LEVELS = 2


def coarse(shape: trimesh.Trimesh, n_faces: int) -> Manifold:
    less = Simplifier.of(*arrays(shape)).to(n_faces)
    return cut(less.vertices, less.faces)


def bumpy() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(4)
    x, y, z = ball.vertices.T
    ball.vertices *= (1 + 0.1 * np.sin(5 * x) * np.sin(4 * y + 1) * np.sin(3 * z + 2))[:, None]
    return ball


def edit(fitted: Fitted, mesh: Manifold, target: Target, bits: int | None = None, cycles: int = 2) -> Edited:
    n_bits = 18 * len(mesh.vertices) if bits is None else bits
    return edited(fitted, mesh, target, LEVELS, n_bits, cycles, Deadline(inf), lambda k, error: None)


def edge_counts(faces: np.ndarray) -> np.ndarray:
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_counts=True)[1]


@pytest.fixture(scope="module")
def ball() -> tuple[Manifold, Target, Fitted, Edited]:
    mesh, target = coarse(bumpy(), 240), target_of(bumpy(), 8000)
    fitted = smooth_fit(mesh, target, LEVELS, 6)
    return mesh, target, fitted, edit(fitted, mesh, target)


def test_the_error_falls_by_more_than_the_bits_grow(ball):
    mesh, target, _, after = ball
    as_long = smooth_fit(mesh, target, LEVELS, 30).error
    more = len(after.mesh.vertices) / len(mesh.vertices)
    assert after.fitted.error * more < 0.9 * as_long


def test_it_stays_a_ball(ball):
    mesh, _, _, after = ball
    shape = trimesh.Trimesh(after.mesh.vertices, after.mesh.faces, process=False)
    assert shape.is_watertight
    assert shape.is_winding_consistent
    assert shape.euler_number == 2
    assert sorted(np.unique(after.mesh.faces)) == list(range(len(after.mesh.vertices)))
    assert len({tuple(sorted(f)) for f in after.mesh.faces.tolist()}) == len(after.mesh.faces)
    assert not np.array_equal(mesh.faces, after.mesh.faces)


def test_equal_edits_of_equal_meshes(ball):
    mesh, target, fitted, after = ball
    again = edit(fitted, mesh, target)
    np.testing.assert_array_equal(after.mesh.faces, again.mesh.faces)
    np.testing.assert_array_equal(after.fitted.control, again.fitted.control)


def test_where_bits_are_dear_vertices_go_and_none_come(ball):
    mesh, target, fitted, after = ball
    dear = edit(fitted, mesh, target, bits=2 * len(mesh.vertices), cycles=1)
    assert len(dear.mesh.vertices) < len(mesh.vertices) < 1.5 * len(dear.mesh.vertices)
    assert len(after.mesh.vertices) > len(dear.mesh.vertices)


def test_a_handle_and_a_rim_stay():
    tube = trimesh.creation.annulus(0.3, 1, 1, sections=64).subdivide().subdivide()
    torus = trimesh.creation.torus(1, 0.3)
    wavy = square(30)
    wavy.vertices[:, 2] = 0.1 * np.sin(7 * wavy.vertices[:, 0]) * np.cos(5 * wavy.vertices[:, 1])
    for shape, euler in ((tube, 0), (torus, 0), (wavy, 1)):
        mesh, target = coarse(shape, 150), target_of(shape, 6000)
        after = edit(fit_with_creases(mesh, target, 2, 2, True), mesh, target, cycles=1)
        made = trimesh.Trimesh(after.mesh.vertices, after.mesh.faces, process=False)
        assert made.euler_number == euler
        counts = edge_counts(after.mesh.faces)
        assert counts.max() == 2
        assert np.count_nonzero(counts == 1) == np.count_nonzero(edge_counts(mesh.faces) == 1)


def test_creases_stay_where_they_are():
    shape = trimesh.creation.cylinder(1, 2, sections=256).subdivide().subdivide()
    mesh, target = coarse(shape, 80), target_of(shape, 6000)
    fitted = fit_with_creases(mesh, target, 2, 4, True)
    assert 0 < len(fitted.sharp) < len(mesh.faces)
    after = edit(fitted, mesh, target)
    assert len(after.fitted.sharp) == len(fitted.sharp)
    edges = {tuple(sorted(e)) for e in after.mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    assert {tuple(e) for e in after.fitted.sharp.tolist()} <= edges


def test_a_polyhedron_has_its_edges_turned():
    # A roof whose quadrilaterals are cut the wrong way: the ridge is a valley there.
    roof = square(6)
    bent = np.abs(roof.vertices[:, 0] + roof.vertices[:, 1] - 1)
    roof.vertices[:, 2] = 0.3 * bent
    wrong = arrays(roof)
    fine = square(60)
    fine.vertices[:, 2] = 0.3 * np.abs(fine.vertices[:, 0] + fine.vertices[:, 1] - 1)
    target = target_of(fine, 8000)
    flipped = wrong.faces.copy()
    half = len(flipped) // 2
    # (a, b, c) and (c, b, d) become (a, b, d) and (a, d, c).
    a, b, c, d = *wrong.faces[:half].T, wrong.faces[half:, 2]
    flipped[:half], flipped[half:] = np.column_stack([a, b, d]), np.column_stack([a, d, c])
    mesh = Manifold(wrong.vertices, flipped)
    fitted = fit_with_creases(mesh, target, 2, 2, True)
    all_sharp = edits._inner(mesh.faces, len(mesh.vertices))
    fitted = fitted._replace(
        basis=edits.coarsest_basis(mesh.faces, len(mesh.vertices), all_sharp, LEVELS),
        sharp=all_sharp,
        control=mesh.vertices,
    )
    before = edits.mean_errors(fitted.basis, target, mesh.vertices).sum()
    after = edit(fitted, mesh, target, bits=10**6)
    assert after.fitted.error < before / 3
    assert len(after.fitted.sharp) == len(all_sharp)


def test_a_deadline_that_is_over_leaves_all_as_it_is(ball):
    mesh, target, fitted, _ = ball
    over = Deadline(0.0)
    while over.passed() < 1:
        pass
    after = edited(fitted, mesh, target, LEVELS, 10**4, 2, over, lambda k, error: None)
    np.testing.assert_array_equal(after.mesh.faces, mesh.faces)
    np.testing.assert_array_equal(after.fitted.control, fitted.control)
