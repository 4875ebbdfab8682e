"""Which edges are made sharp."""

from __future__ import annotations

import numpy as np
import trimesh
from control_meshes import arrays, smooth_fit, square, target_of

from cndhf_codec.encoder.surface import creases
from cndhf_codec.encoder.surface.creases import Fitted, fit_simply, fit_with_creases
from cndhf_codec.encoder.surface.simplify import Simplifier


def creased(mesh: trimesh.Trimesh, shape: trimesh.Trimesh) -> Fitted:
    return fit_with_creases(arrays(mesh), target_of(shape), 3, 4, True)


def test_the_edges_of_a_cube_are_sharp():
    cube = trimesh.creation.box()
    fitted = creased(cube, cube)
    real = {tuple(sorted(e)) for e in cube.face_adjacency_edges[cube.face_adjacency_angles > 1].tolist()}
    assert len(real) == 12
    assert real <= {tuple(e) for e in fitted.sharp.tolist()}
    assert fitted.error < 1e-6


def test_no_edge_of_a_ball_is_sharp():
    ball = trimesh.creation.icosphere(4)
    fitted = creased(trimesh.creation.icosphere(1), ball)
    assert len(fitted.sharp) == 0
    assert fitted.error < 0.003


def test_a_cylinder_has_two_sharp_rings():
    cylinder = trimesh.creation.cylinder(1, 2, sections=256)
    coarse = trimesh.creation.cylinder(1, 2, sections=12)
    fitted = creased(coarse, cylinder)
    heights = np.round(coarse.vertices[:, 2], 6)
    radii = np.round(np.hypot(*coarse.vertices[:, :2].T), 6)
    a, b = fitted.sharp.T
    on_rim = (heights[a] == heights[b]) & (radii[a] == 1) & (radii[b] == 1)
    assert np.count_nonzero(on_rim) == 24
    # Few edges of the round wall are sharp.
    assert np.mean(heights[a] != heights[b]) < 0.3
    smooth = smooth_fit(arrays(coarse), target_of(cylinder), 3, 7)
    assert len(smooth.sharp) == 0
    assert fitted.error < smooth.error / 3


def test_the_corners_of_a_sheet_are_sharp():
    # A rim is a smooth curve by itself; its corners need another sharp edge each.
    fitted = creased(square(3), square(20))
    ends = np.bincount(fitted.sharp.ravel(), minlength=16)
    assert np.count_nonzero(ends) > 0
    smooth = smooth_fit(arrays(square(3)), target_of(square(20)), 3, 7)
    assert fitted.error < smooth.error


def test_a_simple_fit_takes_the_better_of_none_and_all_sharp():
    cube, ball = trimesh.creation.box(), trimesh.creation.icosphere(4)
    faceted = fit_simply(arrays(cube), target_of(cube), 2)
    assert len(faceted.best.sharp) == 18
    assert faceted.faceted
    smooth = fit_simply(arrays(trimesh.creation.icosphere(1)), target_of(ball), 2)
    assert len(smooth.best.sharp) == 0
    assert not smooth.faceted


def test_all_edges_may_be_sharp_where_angled_ones_alone_are_hopeless(monkeypatch):
    rough = trimesh.creation.icosphere(2)
    rough.vertices *= np.random.default_rng(0).uniform(0.9, 1.1, (len(rough.vertices), 1))
    fit = creases._fit
    tried = []

    def with_hopeless_angles(mesh, edges, marked, *rest):
        one, errors = fit(mesh, edges, marked, *rest)
        tried.append(int(marked.sum()))
        return one._replace(error=one.error if marked.all() or not marked.any() else 2.0), errors

    monkeypatch.setattr(creases, "_fit", with_hopeless_angles)
    assert len(creased(rough, rough).sharp) == 480
    assert tried[::2] == [0, 480]
    assert 0 < tried[1] < 480


def test_sharp_edges_are_edges_smaller_number_first():
    shape = trimesh.creation.annulus(0.3, 1, 1, sections=64)
    vertices, faces = Simplifier.of(*arrays(shape)).to(120)
    fitted = fit_with_creases(arrays(trimesh.Trimesh(vertices, faces, process=False)), target_of(shape), 2, 2, True)
    assert len(fitted.sharp) > 20
    edges = {tuple(sorted(e)) for e in np.asarray(faces)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    assert {tuple(e) for e in fitted.sharp.tolist()} <= edges
