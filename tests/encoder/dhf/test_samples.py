"""Samples of a T, and clear space around it."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from cndhf_codec.encoder.dhf.fit import samples as samples_module
from cndhf_codec.encoder.dhf.fit.clear_space import ClearSpace
from cndhf_codec.encoder.dhf.fit.sample_store import SampleStore
from cndhf_codec.encoder.dhf.fit.samples import SHELL_DEPTH, SHELL_SHARE, WALL_DEPTH, draw_samples
from cndhf_codec.encoder.dhf.frames import frame_for_axis


def test_samples_are_what_the_axes_can_say(solid, frames, samples):
    both = trimesh.Trimesh(solid.vertices, solid.faces)
    squared = igl.point_mesh_squared_distance(samples.surface.astype(float), solid.vertices, solid.faces)[0]
    assert squared.max() < 1e-10
    assert samples.seen.any(axis=1).all()
    inside = ~samples.excluded.any(axis=1)
    # Under the arms z sees an end and x, from the side, the stem: the space there is filled by z and carved by x
    # only where the stem does not hide it. No point of the solid is excluded.
    truth = both.contains(samples.space[:3000].astype(float))
    assert inside[:3000][truth].all()
    assert not inside.all()
    assert samples.distance.min() >= 0
    for f in frames:
        uvz = samples.space[10_000:] @ f.rotation.T
        assert (uvz >= f.bounds[:, 0] - 1e-2).mean() > 0.5


def test_clear_space_is_empty_and_in_all_boxes(solid, frames, clear):
    points = clear.draw(20_000, np.random.default_rng(0)).astype(float)
    assert len(points) > 5000
    squared = igl.point_mesh_squared_distance(points, solid.vertices, solid.faces)[0]
    assert squared.min() > 0.02**2
    for f in frames:
        uvz = points @ f.rotation.T
        assert (uvz >= f.bounds[:, 0] - 1e-6).all()
        assert (uvz <= f.bounds[:, 1] + 1e-6).all()
    excluded, distance = clear.truth(points[:1000].astype(np.float32))
    assert excluded.any(axis=1).mean() > 0.99
    np.testing.assert_allclose(distance**2, squared[:1000], atol=1e-6)


def test_what_an_axis_fills_has_a_boundary_too(solid):
    # Askew, the corners under the arms are filled, up to walls that hang from the arms' ends, far from every face.
    frames = [frame_for_axis(np.array([1.0, 0.0, 1.0]) / np.sqrt(2), solid.vertices)]
    samples = draw_samples(solid, frames, 4000, 0)
    outside, points = samples.excluded.any(axis=1), samples.space.astype(float)
    faces = solid.distances(points)
    apart = np.linalg.norm(points[outside][:, None] - points[~outside][None], axis=2)
    for side, nearest in ((outside, apart.min(axis=1)), (~outside, apart.min(axis=0))):
        expected = np.where(nearest < 0.1, np.minimum(nearest, faces[side]), faces[side])
        np.testing.assert_allclose(samples.distance[side], expected, atol=1e-5)
        assert (samples.distance[side] < faces[side] - 0.05).sum() > 5
    again, distance = ClearSpace(solid, frames, samples.sides).truth(samples.space)
    np.testing.assert_array_equal(again.any(axis=1), outside)
    np.testing.assert_allclose(distance, samples.distance, atol=1e-5)


def test_where_all_is_seen_only_faces_count(solid, samples):
    np.testing.assert_allclose(samples.distance, solid.distances(samples.space.astype(float)), atol=1e-5)


def test_a_share_of_the_samples_stands_at_the_walls_of_the_boxes(solid, frames, monkeypatch):
    # Slivers of solid like to stand there. Of those that are uniform, which is half of all, a quarter is put there.
    def beside() -> float:
        space = draw_samples(solid, frames, 20_000, 0).space
        near_walls = np.zeros(len(space), dtype=bool)
        for f in frames:
            uvz = space @ f.rotation.T
            depth = np.minimum(uvz - f.bounds[:, 0], f.bounds[:, 1] - uvz)
            near_walls |= ((depth > -1e-6) & (depth < WALL_DEPTH)).any(axis=1)
        return float(near_walls.mean())

    put = beside()
    monkeypatch.setattr(samples_module, "WALL_SHARE", 0)
    assert put - beside() == pytest.approx(0.25 * (1 - SHELL_SHARE) / 2, rel=0.25)


def test_a_share_of_the_samples_is_just_outside_the_bounding_box(solid, frames):
    samples = draw_samples(solid, frames, 20_000, 0)
    beyond = np.maximum(samples.box[0] - samples.space, samples.space - samples.box[1]).max(axis=1)
    assert ((beyond > 0) & (beyond <= SHELL_DEPTH)).mean() > 0.9 * SHELL_SHARE / 2


def test_what_a_sample_off_the_surface_weighs(samples, frames):
    store = SampleStore(samples, frames)
    box = samples.box
    points = np.array([box.mean(axis=0), box[1] + 0.03], dtype=np.float32)
    excluded = np.array([[False, False], [True, True]])
    for distance in (0.0, 0.02, 0.1):
        store.add_counterexamples(0, points, excluded, np.full(2, distance, dtype=np.float32))
    inside, outside = store.weight[store.counterexamples(0)].reshape(3, 2).T
    # A floater costs its area times its distance; outside the input's box, ten times that.
    np.testing.assert_allclose(inside, [1, 2, 6], rtol=1e-5)
    np.testing.assert_allclose(outside, [10, 20, 60], rtol=1e-5)
    np.testing.assert_allclose(
        store.weight[: store.n_space].numpy().min(), 0.4 * (1 + samples.distance.min() / 0.02), rtol=1e-3
    )
    assert store.margin[store.counterexamples(0)].max() == pytest.approx(0.03)
