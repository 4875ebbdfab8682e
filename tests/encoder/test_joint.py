"""The joint method, stage by stage, on a small shape that needs two axes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import igl
import numpy as np
import pytest
import torch
import trimesh

from cndhf_codec.cli.sizes import parse_size
from cndhf_codec.encoder import rounding, settings
from cndhf_codec.encoder.axisset import AxisCosts
from cndhf_codec.encoder.composite import Composite
from cndhf_codec.encoder.gauss_newton import blocks
from cndhf_codec.encoder.heights import frame_for_axis
from cndhf_codec.encoder.joint import width_for
from cndhf_codec.encoder.normalise import normalisation
from cndhf_codec.encoder.pipeline import encode_with_report
from cndhf_codec.encoder.read import read_mesh
from cndhf_codec.encoder.samples import draw_samples
from cndhf_codec.encoder.siren import Trace, forward, heights, initialise
from cndhf_codec.encoder.solid import Solid
from cndhf_codec.encoder.tune import tune
from cndhf_codec.errors import OptionError

CPU = torch.device("cpu")
SMALL = replace(settings.PRESETS["default"], batch=512, rounds=2, round_steps=30)


@pytest.fixture(scope="module")
def solid() -> Solid:
    """A T: along z its arms hide the floor under them, along y nothing is hidden."""
    top = trimesh.creation.box((1.6, 0.4, 0.4), trimesh.transformations.translation_matrix((0, 0, 0.6)))
    stem = trimesh.creation.box((0.4, 0.4, 1.0))
    mesh = read_mesh(trimesh.boolean.union([top, stem], engine="manifold").subdivide())
    return Solid(normalisation(mesh).apply(mesh.vertices), mesh.faces)


@pytest.fixture(scope="module")
def frames(solid):
    return [frame_for_axis(np.array(a, dtype=float), solid.vertices) for a in ((0, 0, 1), (1, 0, 0))]


@pytest.fixture(scope="module")
def samples(solid, frames):
    return draw_samples(solid, frames, 20_000, 0)


def networks(width: int = 8, count: int = 2) -> list[list[torch.Tensor]]:
    return [
        [t.requires_grad_() for t in initialise(width, 5, 30.0, torch.Generator().manual_seed(k))] for k in range(count)
    ]


def test_the_tiled_evaluation_has_torch_s_values_and_gradients():
    (net,) = networks(count=1)
    uv = torch.rand(3000, 2) * 2 - 1  # not a whole number of tiles
    pull = torch.randn(3000, 2)
    pull[:1024] = 0  # a tile without gradient
    pull[1024:1800] = 0  # rows without gradient
    expected = torch.autograd.grad((forward(net, uv, 30.0) * pull).sum(), net)
    got = torch.autograd.grad((heights(net, uv, 30.0) * pull).sum(), net)
    torch.testing.assert_close(heights(net, uv, 30.0), forward(net, uv, 30.0), atol=1e-5, rtol=0)
    for a, b in zip(expected, got, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3 * float(a.abs().max()))


def test_the_jacobian_is_torch_s():
    (net,) = networks(width=5, count=1)
    uv = torch.rand(6, 2)
    side = np.array([0, 1, 1, 0, 1, 0])
    jacobian = Trace([t.detach().numpy() for t in net], uv.numpy(), 30.0).jacobian(side)
    for i in range(6):
        row = torch.autograd.grad(forward(net, uv, 30.0)[i, side[i]], net)
        expected = torch.cat([g.ravel() for g in row]).numpy()
        np.testing.assert_allclose(jacobian[i], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


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


def test_the_joint_fit_lowers_the_loss_and_keeps_what_is_held(frames, samples):
    composite = Composite(samples, frames, 30.0, CPU)
    nets = networks()
    losses: list[float] = []
    held = [[torch.zeros(t.shape, dtype=torch.bool) for t in n] for n in nets]
    held[0][2][:] = True
    before = nets[0][2].detach().clone()
    tune(nets, composite, SMALL, 200, 3e-3, 0, lambda step, loss: losses.append(loss), held)
    assert losses[-1] < 0.5 * losses[0]
    assert torch.equal(nets[0][2].detach(), before)
    assert not torch.equal(nets[1][2].detach(), networks()[1][2].detach())


def test_the_matrix_does_not_depend_on_threads(frames, samples):
    composite = Composite(samples, frames, 30.0, CPU)
    surface, space = composite.draw(4000, 2000, torch.Generator().manual_seed(0))
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(3) as three:
        a, b = (blocks(networks(), composite, surface, space, pool) for pool in (one, three))
    for x, y in zip(a, b, strict=True):
        assert np.array_equal(x, y)
        assert np.linalg.eigvalsh(x).min() > -1e-6 * np.trace(x)


def test_error_feedback_beats_plain_rounding():
    rng = np.random.default_rng(0)
    # Strongly coupled weights, as those of a network are.
    basis = rng.normal(size=(60, 60)) * np.logspace(0, -2, 60)
    H = basis @ basis.T
    theta, step = rng.normal(size=60), np.full(60, 0.1)
    order = np.argsort(-np.diag(H), kind="stable")
    rounded = rounding._round_in_order(theta, H, step, order, 60)
    np.testing.assert_allclose(rounded / step, np.rint(rounded / step), atol=1e-9)

    def cost(w: np.ndarray) -> float:
        return float((w - theta) @ H @ (w - theta))

    assert cost(rounded) < 0.5 * cost(np.rint(theta / step) * step)


def test_rounded_networks_are_multiples_of_their_steps(frames, samples, monkeypatch):
    monkeypatch.setattr(rounding, "SURFACE", 3000)
    monkeypatch.setattr(rounding, "SPACE", 1500)
    composite = Composite(samples, frames, 30.0, CPU)
    nets = networks()
    with ThreadPoolExecutor(2) as pool:
        logs = rounding.relative_steps(nets, rounding.matrices(nets, composite, 0, pool))
        codes = rounding.step_codes(nets, logs, 5.0)
        rounding.round_networks(nets, composite, SMALL, codes, 0, pool, lambda step, loss: None)
    for net, of_net in zip(nets, codes, strict=True):
        for tensor, code in zip(net, of_net, strict=True):
            symbols = tensor.detach().double() * 2 ** (code / 4)
            torch.testing.assert_close(symbols, symbols.round(), atol=1e-2, rtol=0)


def test_axes_are_chosen_by_what_they_leave(solid):
    costs = AxisCosts(solid, 0, 2)
    (first,) = costs.best(1)
    # The T's silhouette is along y; every other axis fills something in or sees more of it slantwise.
    assert abs(costs.axes[first][1]) > 0.5
    assert costs.mean_cost(costs.best(2)) < costs.mean_cost([first])
    assert costs.visible == pytest.approx(1, abs=0.01)
    assert sum(costs.shares(costs.best(3))) == pytest.approx(1)


def test_the_width_follows_from_the_size():
    at = [width_for(replace(SMALL, target_size=s), 2, 30) for s in (1024, 4096, 16384)]
    assert at == sorted(at)
    assert at[0] >= 5
    assert width_for(replace(SMALL, target_size=4096), 1, 30) > at[1]


@pytest.mark.parametrize("size", [900, 2500])
def test_a_target_size_is_met(creature, monkeypatch, size):
    monkeypatch.setattr(rounding, "SURFACE", 3000)
    monkeypatch.setattr(rounding, "SPACE", 1500)
    tiny = replace(
        settings.PRESETS["fast"], steps=60, batch=512, samples=10_000, tune_steps=80, rounds=2, round_steps=20
    )
    monkeypatch.setitem(settings.PRESETS, "fast", replace(tiny, target_resolution=96, verify_resolution=48))
    model, report = encode_with_report(creature, "fast", target_size=size)
    assert 0.95 * size <= len(model.dumps()) <= size
    assert report.normalised.chamfer < 0.3


def test_sizes_on_the_command_line():
    assert [parse_size(t) for t in ("4096", "4KB", "4 KiB", "1.5kb", "2MB")] == [4096, 4000, 4096, 1500, 2_000_000]
    for bad in ("", "4 apples", "-3", "KB"):
        with pytest.raises(OptionError, match="target size"):
            parse_size(bad)
