"""The single fit of a small sphere: it learns, repeats exactly, stops when told, and reports when it diverges."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
import trimesh
from jointly import Looks

from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.fit.single import Training, fit_each, fit_single, one_torch_thread
from cndhf_codec.encoder.dhf.fit.targets import height_targets
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.encoder.dhf.network.siren import forward, initialise
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.errors import EncodeError
from cndhf_codec.format.container import tensor_shapes
from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode

SMALL = Training(width=8, hidden_layers=2, omega=30, steps=600, learning_rate=3e-3, batch=512, margin=0.01)


@pytest.fixture(scope="module")
def targets():
    mesh = trimesh.creation.icosphere(4, 0.8)
    solid = Solid(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))
    axes = np.array([[0.0, 0, 1], [1, 0, 0], [0.6, 0, 0.8]])
    return [height_targets(solid, frame_for_axis(a, solid.vertices), 48) for a in axes]


def fit(targets, training=SMALL, seed=0, threads=1, on_step=lambda *_: None, deadline=None):
    deadline = deadline or Deadline()
    fits = [partial(fit_single, t, training, seed + k, deadline) for k, t in enumerate(targets)]
    with ThreadPool(threads) as pool:
        networks = fit_each(fits, pool, on_step)
    return [[t.numpy() for t in n.tensors(0)] for n in networks]


def outcome(tensors, t) -> tuple[float, float]:
    """Mean height error inside the silhouette and share of the pixels outside that are empty."""
    y = Network(tensors, SMALL.omega, SMALL.omega)(t.uv.reshape(-1, 2))
    hit = t.hit.ravel()
    truth = np.stack([t.near.ravel(), t.far.ravel()], axis=1)
    return float(np.abs(y - truth)[hit].mean()), float((y[~hit, 1] < y[~hit, 0]).mean())


def test_the_fit_learns_heights_and_silhouette(targets):
    (untrained,) = fit(targets[:1], replace(SMALL, steps=1))
    (tensors,) = fit(targets[:1])
    error, empty = outcome(tensors, targets[0])
    assert outcome(untrained, targets[0])[0] > 0.3
    assert error < 0.1
    assert empty > 0.8
    assert [t.shape for t in tensors] == tensor_shapes(8, 2)


def test_unknown_heights_pull_at_nothing(targets):
    # Heights seen through a hole are noise: with them marked unknown the others are learned all the same.
    t = targets[0]
    hidden = t.hit & (t.uv[..., 0] > 0.1)
    spoilt = replace(t, far=np.where(hidden, -5, t.far).astype(np.float32), far_known=t.far_known & ~hidden)
    (tensors,) = fit([spoilt])
    y = Network(tensors, SMALL.omega, SMALL.omega)(t.uv.reshape(-1, 2)).reshape(*t.hit.shape, 2)
    assert np.abs(y[..., 0] - t.near)[t.hit].mean() < 0.15
    assert y[..., 1][hidden].mean() > -1


def test_threads_do_not_change_a_bit(targets):
    training = replace(SMALL, steps=40)
    one, two = fit(targets, training, threads=1), fit(targets, training, threads=2)
    again = fit(targets, training, threads=2)
    for a, b, c in zip(one, two, again, strict=True):
        assert all(x.tobytes() == y.tobytes() == z.tobytes() for x, y, z in zip(a, b, c, strict=True))


def test_seeds_do(targets):
    training = replace(SMALL, steps=2)
    a, b = fit(targets[:1], training, seed=0)[0], fit(targets[:1], training, seed=1)[0]
    assert not np.array_equal(a[0], b[0])


def test_progress_counts_the_steps_of_all_fits(targets):
    seen = []
    fit(targets, replace(SMALL, steps=50), threads=2, on_step=lambda *a: seen.append(a))
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1][0] == 150
    assert all(np.isfinite(loss) for _, loss in seen)


def test_a_deadline_ends_the_fit(targets):
    (first,) = fit(targets[:1], replace(SMALL, steps=1))
    (tensors,) = fit(targets[:1], replace(SMALL, steps=10**7), deadline=Looks(200))
    assert outcome(tensors, targets[0])[0] < outcome(first, targets[0])[0]


def test_an_interrupt_stops_the_other_fits(targets):
    # Ten million steps: this ends only when every fit is told to stop.
    def interrupt(*_):
        raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        fit(targets, replace(SMALL, steps=10**7), threads=2, on_step=interrupt)
    assert threading.active_count() == before


def test_torch_threads_are_given_back():
    before = torch.get_num_threads()
    with one_torch_thread():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


def test_divergence_is_an_error(targets):
    with pytest.raises(EncodeError, match=r"diverged.*seed"):
        fit(targets, replace(SMALL, learning_rate=1e38))


def test_torch_and_numpy_agree_on_the_network():
    network = initialise(9, 3, 30, torch.Generator().manual_seed(0))
    uv = torch.rand((50, 2), generator=torch.Generator().manual_seed(1)) * 2 - 1
    in_torch = forward(network, 0, uv).numpy()
    in_numpy = Network([t.numpy() for t in network.tensors(0)], 30, 30)(uv.numpy())
    np.testing.assert_allclose(in_numpy, in_torch, atol=1e-4)


def test_initial_weights_have_the_ranges_of_the_paper():
    tensors = initialise(64, 2, 30, torch.Generator().manual_seed(0)).tensors(0)
    assert [tuple(t.shape) for t in tensors] == tensor_shapes(64, 2)
    limits = [0.5, 0.5**0.5] + [(6 / 64) ** 0.5 / 30, 1 / 8] * 3  # U(+-1/2), then U(+-sqrt(6/64)/30)
    for t, limit in zip(tensors, limits, strict=True):
        assert float(t.abs().max()) <= limit
    for t, limit in zip(tensors[0:6:2], limits[0:6:2], strict=True):
        assert float(t.abs().max()) > 0.9 * limit
