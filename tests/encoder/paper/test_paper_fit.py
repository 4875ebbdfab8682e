"""The paper's fit: its compiled loss beside torch's, what it learns, and where it stops."""

from __future__ import annotations

from dataclasses import replace
from threading import Event

import numpy as np
import pytest
import torch
import trimesh
from jointly import Looks

from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.fit.targets import HeightTargets, height_targets
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.encoder.dhf.network.siren import forward, initialise
from cndhf_codec.encoder.paper.fit import RATE_WIDTH, fit_paper, tile_images, weights_of
from cndhf_codec.encoder.paper.settings import PaperSettings
from cndhf_codec.encoder.paper.steps import TILE_SIDE, gradient
from cndhf_codec.errors import EncodeError
from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode

RADIUS = 0.8
SMALL = PaperSettings(width=8, hidden_layers=2, steps=800, batch=1024)


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    return Solid(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def targets_of(mesh: trimesh.Trimesh, axis: list[float], resolution: int) -> HeightTargets:
    solid = solid_of(mesh)
    return height_targets(solid, frame_for_axis(np.array(axis), solid.vertices), resolution)


@pytest.fixture(scope="module")
def ball() -> HeightTargets:
    return targets_of(trimesh.creation.icosphere(5, RADIUS), [0.0, 0.0, 1.0], 64)


def fit(t: HeightTargets, settings: PaperSettings = SMALL, deadline: Deadline | None = None) -> np.ndarray:
    """Heights (nu, nv, 2) of the fitted network."""
    network = fit_paper(t, settings, 0, deadline or Deadline(), Event(), lambda *_: None)
    tensors = [x.numpy() for x in network.tensors(0)]
    return Network(tensors, settings.omega, settings.omega)(t.uv.reshape(-1, 2)).reshape(*t.hit.shape, 2)


def test_laplacians_of_planes_are_zero_and_those_of_a_sphere_are_not(ball):
    tilted = targets_of(trimesh.creation.box((0.8, 0.8, 0.8)), [0.12, -0.18, 0.98], 64)
    images = tile_images(tilted)
    # Wherever all five pixels lie on one face.
    flat = (images.laplacian_known == 1) & (np.linalg.norm(tilted.uv, axis=-1) < 0.2)
    assert flat.sum() > 50
    assert np.abs(images.laplacians[flat]).max() < 1e-6
    images = tile_images(ball)
    pixel = float(ball.uv[1, 0, 0] - ball.uv[0, 0, 0])
    middle = (images.laplacian_known == 1) & (np.linalg.norm(ball.uv, axis=-1) < 0.3)
    # d2z/du2 + d2z/dv2 = -2 / R at the top, times the pixel's area.
    expected = 2 / RADIUS * pixel**2
    assert images.laplacians[middle].mean(axis=0) == pytest.approx([expected, -expected], rel=0.2)
    assert not images.laplacian_known[~ball.hit].any()


@pytest.mark.parametrize(("resolution", "tiles"), [(64, 40), (12, 3)])  # one block of points, and more
def test_the_compiled_loss_is_torch_s(resolution, tiles):
    t = targets_of(trimesh.creation.icosphere(4, RADIUS), [0.6, 0.0, 0.8], resolution)
    images, weights = tile_images(t), weights_of(SMALL)
    net = initialise(8, 2, 30.0, torch.Generator().manual_seed(0))
    theta = net.theta.requires_grad_()
    side = TILE_SIDE
    first = np.random.default_rng(0).integers(np.array(t.hit.shape) - side + 1, size=(tiles, 2))
    loss = torch.zeros(())
    for i, j in first:
        at = np.s_[i : i + side, j : j + side]
        y = forward(net, 0, torch.from_numpy(t.uv[at]))
        truth, known = (torch.from_numpy(a[at].copy()) for a in (images.heights, images.known))
        error = ((y - truth).abs() * known).sum(dim=-1).mean()
        outside = 1 - torch.from_numpy(images.hit[at].copy())
        hinge = (torch.relu(y[..., 1] - y[..., 0] + SMALL.margin) * outside).mean()
        laplacian = y[2:, 1:-1] + y[:-2, 1:-1] + y[1:-1, 2:] + y[1:-1, :-2] - 4 * y[1:-1, 1:-1]
        inner = np.s_[i + 1 : i + side - 1, j + 1 : j + side - 1]
        wrong = (laplacian - torch.from_numpy(images.laplacians[inner].copy())).abs().sum(dim=-1)
        smooth = (wrong * torch.from_numpy(images.laplacian_known[inner].copy())).mean()
        loss = loss + (error + hinge + SMALL.laplacian * smooth) / tiles
    (expected,) = torch.autograd.grad(loss, theta)
    value, got = gradient(net.net(0), images, first, weights)
    assert value == pytest.approx(loss.item(), rel=1e-5)
    np.testing.assert_allclose(got, expected[0], rtol=1e-3, atol=1e-3 * float(expected.abs().max()))


def test_the_fit_learns_heights_and_silhouette(ball):
    y = fit(ball)
    truth = np.stack([ball.near, ball.far], axis=-1)
    assert np.abs(y - truth)[ball.hit].mean() < 0.08
    assert (y[~ball.hit, 1] < y[~ball.hit, 0]).mean() > 0.8


def test_more_steps_have_less_error(ball):
    truth = np.stack([ball.near, ball.far], axis=-1)
    errors = [np.abs(fit(ball, replace(SMALL, steps=n)) - truth)[ball.hit].mean() for n in (100, 1000)]
    assert errors[1] < 0.6 * errors[0]


def test_a_deadline_and_other_fits_stop_it(ball):
    steps: list[int] = []
    endless = replace(SMALL, steps=10**9)
    fit_paper(ball, endless, 0, Looks(3), Event(), lambda step, loss: steps.append(step))
    assert steps == [100, 200, 300]
    stop = Event()
    stop.set()
    fit_paper(ball, endless, 0, Deadline(), stop, lambda step, loss: steps.append(step))
    assert steps == [100, 200, 300]


def test_divergence_is_an_error(ball):
    with pytest.raises(EncodeError, match=r"diverged.*seed"):
        fit(ball, replace(SMALL, learning_rate=1e38))


def test_a_fit_that_collapses_is_an_error_and_one_that_recovers_is_not(ball, monkeypatch):
    def fit_with(losses):
        left = iter(losses)
        monkeypatch.setattr("cndhf_codec.encoder.paper.fit.adam_steps", lambda *_: next(left))
        fit(ball, replace(SMALL, steps=100 * len(losses)))

    fit_with([1.0, 0.03, 0.5, 0.04])
    with pytest.raises(EncodeError, match=r"diverged.* from 0.03 to 0.42; .*seed or a smaller --width"):
        fit_with([1.0, 0.03, 0.42])


def test_wider_fields_learn_in_smaller_steps(ball, monkeypatch):
    rates = []
    monkeypatch.setattr("cndhf_codec.encoder.paper.fit.adam_steps", lambda *a: rates.append(a[5]) or 1.0)
    for width in (RATE_WIDTH, 2 * RATE_WIDTH):
        fit(ball, replace(SMALL, width=width, steps=100))
    np.testing.assert_allclose(rates[0], 2 * rates[1])
    assert rates[0].max() <= SMALL.learning_rate
