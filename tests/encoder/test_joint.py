"""The joint method, stage by stage, on a small shape that needs two axes."""

from __future__ import annotations

import time
from dataclasses import replace

import igl
import numpy as np
import pytest
import torch
import trimesh

from cndhf_codec.cli.sizes import parse_size
from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.encoder import settings
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf import encode as joint
from cndhf_codec.encoder.dhf.axes.costs import AxisCosts
from cndhf_codec.encoder.dhf.encode import widths_for
from cndhf_codec.encoder.dhf.fit import loss as composite_module
from cndhf_codec.encoder.dhf.fit.joint import LEAST_RATE, IdleNetworkError, tune
from cndhf_codec.encoder.dhf.fit.loss import REACH, SUSPECTS, Composite, _runs
from cndhf_codec.encoder.dhf.fit.samples import FarSpace, Samples, draw_samples
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.encoder.dhf.network import kernel
from cndhf_codec.encoder.dhf.network.siren import Networks, forward, heights, initialise, stacked
from cndhf_codec.encoder.dhf.network.soap import Soap
from cndhf_codec.encoder.dhf.rounding import feedback as rounding
from cndhf_codec.encoder.dhf.rounding.feedback import COARSEST, relative_steps, step_codes
from cndhf_codec.encoder.dhf.rounding.gauss_newton import blocks
from cndhf_codec.encoder.pipeline import encode_with_report
from cndhf_codec.encoder.thread_pool import Team
from cndhf_codec.errors import EncodeError, OptionError
from cndhf_codec.format.constants import MAX_SYMBOL, STEPS_PER_OCTAVE
from cndhf_codec.format.container import parameter_count
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid

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


@pytest.fixture(scope="module")
def far(solid, frames, samples):
    return FarSpace(solid, frames, samples.sides)


@pytest.fixture(scope="module")
def composite(samples, far, frames):
    return Composite(samples, far, frames, CPU, Team(1))


def job_of(solid: Solid, options: settings.Settings) -> joint.Job:
    return joint.Job(solid, options, 30, 0, CPU, Team(1), stage=lambda name, total: lambda done, loss: None)


def plan_of(job: joint.Job, frames: list, shares: list[float]) -> joint.Plan:
    return joint.Plan(frames, shares, widths_for(job.settings, shares, 30), 0.0, 1.0, 1.0)


def networks(width: int = 8, count: int = 2) -> Networks:
    return of_widths(*[width] * count)


def of_widths(*widths: int) -> Networks:
    return stacked([initialise(w, 5, 30.0, torch.Generator().manual_seed(k)) for k, w in enumerate(widths)])


def used(nets: Networks) -> np.ndarray:
    """(K, P): what of theta is weights."""
    return np.arange(nets.theta.shape[1]) < np.array(nets.counts)[:, None]


@pytest.mark.parametrize("width", [5, 8, 19])
def test_the_compiled_evaluation_has_torch_s_values_and_gradients(width):
    net = networks(width, count=1)
    theta = net.theta.requires_grad_()
    uv = torch.rand(3001, 2, generator=torch.Generator().manual_seed(0)) * 2 - 1  # not a whole number of tiles
    pull = torch.randn(3001, 2, generator=torch.Generator().manual_seed(1))
    expected = torch.autograd.grad((forward(net, 0, uv) * pull).sum(), theta)[0]
    got = torch.autograd.grad((heights(net, 0, uv) * pull).sum(), theta)[0]
    torch.testing.assert_close(heights(net, 0, uv), forward(net, 0, uv), atol=1e-5, rtol=0)
    torch.testing.assert_close(expected, got, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_the_jacobian_is_torch_s():
    net = networks(width=5, count=1)
    theta = net.theta.requires_grad_()
    uv = torch.rand(300, 2, generator=torch.Generator().manual_seed(0))
    side = np.arange(300) % 2
    jacobian = kernel.jacobian(theta[0].detach().numpy(), *net.for_kernel(0), uv.numpy(), side)
    for i in (0, 1, 150, 299):
        expected = torch.autograd.grad(forward(net, 0, uv)[i, side[i]], theta)[0].numpy()[0]
        np.testing.assert_allclose(jacobian[i], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("looked", [False, True])
@pytest.mark.parametrize("widths", [(8, 8), (9, 8)])
def test_the_compiled_loss_has_the_gradient_of_its_terms(samples, far, frames, looked, widths):
    nets = of_widths(*widths)
    composite = Composite(samples, far, frames, CPU, Team(1))
    if looked:  # then networks that are not near a sample are left out
        composite.look(nets, REACH)
        assert composite._near_surface.float().mean() < 0.9
        assert composite._near_space.float().mean() < 0.9
    batch = composite.draw_batches(1500, 1100, 1, np.random.default_rng(0))
    theta = nets.theta.clone().requires_grad_()
    cost = composite.terms(replace(nets, theta=theta), *composite.rows(batch)).cost
    loss = cost[:1500].mean() + cost[1500:].sum() / 1100
    (expected,) = torch.autograd.grad(loss, theta)
    got, value = composite.gradient(nets, batch)
    assert value == pytest.approx(loss.item(), rel=1e-5)
    torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))
    assert (got.abs().max(dim=1).values > 0).all()
    assert not got[torch.from_numpy(~used(nets))].any()


def test_what_is_left_out_costs_nothing(samples, far, frames, monkeypatch):
    monkeypatch.setattr(Composite, "_shares", lambda self, n: [])  # violations are drawn more often on purpose
    nets = networks(count=2)
    losses = []
    for reach in (1e3, REACH):
        composite = Composite(samples, far, frames, CPU, Team(1))
        composite.look(nets, reach)
        rng = np.random.default_rng(0)
        batches = composite.draw_batches(2000, 2000, 60, rng)
        losses.append(
            np.mean([composite.gradient(nets, batch)[1] for batch in map(batches.part, range(60), range(1, 61))])
        )
    assert composite._active < 0.9 * composite.n_space
    assert losses[1] == pytest.approx(losses[0], rel=0.03)


def test_runs_are_uniform():
    rng = np.random.default_rng(0)
    for first, last in ((5, 6), (0, 40), (100, 500)):
        at = _runs(first, last, 1000, 200, rng)
        assert at.shape == (200, 1000)
        counts = np.bincount(at.ravel(), minlength=last)
        assert counts[:first].sum() == 0
        assert counts[first:].min() > 0.5 * counts[first:].max()
    assert _runs(7, 7, 10, 3, rng).shape == (3, 0)


def some_steps(samples: Samples, far: FarSpace, frames: list, threads: int) -> tuple:
    """Two networks of different widths after twenty steps in threads, with some weights held: theta, loss, pulled."""
    nets = of_widths(9, 8)
    held = torch.zeros(nets.theta.shape, dtype=torch.bool)
    held[0, 100:300] = True
    with Team(threads) as team:
        composite = Composite(samples, far, frames, CPU, team)
        optimiser = Soap(nets)
        batches = composite.draw_batches(1500, 1100, 21, np.random.default_rng(0))
        rates = np.full((21, 2), [1e-3, 5e-4])
        composite.descend(nets, optimiser, batches.part(0, 1), rates[:1], held)
        assert optimiser.started
        return nets.theta, *composite.descend(nets, optimiser, batches.part(1, 21), rates[1:], held)


def test_threads_do_not_change_the_steps(samples, far, frames):
    results = [some_steps(samples, far, frames, threads) for threads in (1, 2, 3, 7)]
    for theta, loss, pulled in results[1:]:
        assert torch.equal(theta, results[0][0])
        assert loss == results[0][1]
        assert pulled.all()


def test_steps_together_are_steps_one_by_one(samples, far, frames):
    together, loss, _ = some_steps(samples, far, frames, 1)
    nets, composite = of_widths(9, 8), Composite(samples, far, frames, CPU, Team(1))
    before, optimiser = nets.theta.clone(), Soap(nets)
    batches = composite.draw_batches(1500, 1100, 21, np.random.default_rng(0))
    for s in range(21):
        gradient, one_loss = composite.gradient(nets, batches.part(s, s + 1))
        gradient[0, 100:300] = 0
        optimiser.step(gradient, np.array([1e-3, 5e-4]))
        nets.theta[0, 100:300] = before[0, 100:300]
    assert loss == pytest.approx(one_loss, rel=1e-4)
    torch.testing.assert_close(together, nets.theta, rtol=0, atol=1e-5)
    assert (together - before).abs().max() > 3e-3


def test_a_thread_that_fails_does_not_leave_the_others_waiting(samples, far, frames, monkeypatch):
    real = composite_module.take_steps

    def failing(me: int, *rest: object) -> None:
        if me == 1:
            raise MemoryError("no room")
        real(me, *rest)

    monkeypatch.setattr(composite_module, "take_steps", failing)
    with pytest.raises(MemoryError, match="no room"):
        some_steps(samples, far, frames, 2)


def test_an_interrupt_does_not_leave_the_others_waiting(samples, far, frames, monkeypatch):
    real = Team.map

    def interrupted(team: Team, run: object, threads: object) -> object:
        def part(me: int) -> object:
            if me == 0:
                raise KeyboardInterrupt
            return run(me)

        return real(team, part, threads)

    monkeypatch.setattr(Team, "map", interrupted)
    with pytest.raises(KeyboardInterrupt):
        some_steps(samples, far, frames, 3)


def test_a_team_keeps_the_order_and_passes_errors_on():
    for threads in (1, 2, 3, 9):
        with Team(threads) as team:
            assert team.map(lambda x: x * x, range(7)) == [x * x for x in range(7)]
            with pytest.raises(ZeroDivisionError):
                team.map(lambda x: 1 // x, [1, 2, 0, 3])


def test_soap_rotates_and_finds_the_minimum():
    # Strongly coupled least squares on every hidden matrix: plain gradients crawl.
    nets = networks(width=6)
    rng = torch.Generator().manual_seed(0)
    mix = torch.randn(6, 6, generator=rng) * torch.logspace(0, -2, 6)
    target = torch.randn(nets.theta.shape, generator=rng)
    optimiser = Soap(nets)

    def loss(theta: torch.Tensor) -> torch.Tensor:
        of = replace(nets, theta=theta - target)
        errors = [e for k in range(len(nets)) for e in of.tensors(k) if e.dim() == 2]
        return sum(((mix @ e if len(e) == 6 else e) ** 2).sum() for e in errors)

    start = loss(nets.theta)
    for step in range(400):
        theta = nets.theta.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(loss(theta), theta)
        optimiser.step(gradient, 0.03 * (1 - step / 400))
    assert loss(nets.theta) < 1e-3 * start


@pytest.mark.parametrize(("width", "steps"), [(9, 20), (24, 20), (30, 8.2), (60, 4)])
def test_soap_forgets_sooner_in_wide_networks(width, steps):
    assert 1 / Soap(networks(width=width)).state[1] == pytest.approx(steps, abs=0.01)


def test_each_network_steps_at_its_own_rate():
    nets = networks(count=3)
    before, optimiser = nets.theta.clone(), Soap(nets)
    gradient = torch.randn(nets.theta[:1].shape, generator=torch.Generator().manual_seed(0)).expand(3, -1)
    for _ in range(2):
        optimiser.step(gradient, np.array([1e-3, 5e-4, 2e-4]))
    lengths = (nets.theta - before).norm(dim=1)
    torch.testing.assert_close(lengths / lengths[0], torch.tensor([1, 0.5, 0.2]), rtol=1e-3, atol=0)


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


def test_soap_bears_gradients_that_are_zero_or_nearly():
    nets = networks(width=6)
    start = nets.theta.clone()
    optimiser = Soap(nets)
    rng = torch.Generator().manual_seed(0)
    for step in range(100):
        gradient = torch.randn(start.shape, generator=rng) * (1e-18 if step % 3 else 1e-22)
        gradient[torch.rand(start.shape, generator=rng) < 0.9] = 0  # most weights are held
        gradient[:, 20:200] = 0
        optimiser.step(gradient, 1e-3)
    assert torch.isfinite(nets.theta).all()
    assert torch.equal(nets.theta[:, 40:150], start[:, 40:150])


def test_a_joint_fit_that_diverges_is_an_error(composite):
    nets = networks()
    nets.theta[1, 50] = float("nan")
    with pytest.raises(EncodeError, match=r"diverged.*seed"):
        tune(nets, composite, 64, 2, 1e-3, 0, lambda step, loss: None, Deadline())


def test_far_space_is_empty_and_in_all_boxes(solid, frames, far):
    points = far.draw(20_000, np.random.default_rng(0)).astype(float)
    assert len(points) > 5000
    squared = igl.point_mesh_squared_distance(points, solid.vertices, solid.faces)[0]
    assert squared.min() > 0.02**2
    for f in frames:
        uvz = points @ f.rotation.T
        assert (uvz >= f.bounds[:, 0] - 1e-6).all()
        assert (uvz <= f.bounds[:, 1] + 1e-6).all()
    excluded, distance = far.truth(points[:1000].astype(np.float32))
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
    again, distance = FarSpace(solid, frames, samples.sides).truth(samples.space)
    np.testing.assert_array_equal(again.any(axis=1), outside)
    np.testing.assert_allclose(distance, samples.distance, atol=1e-5)


def test_where_all_is_seen_only_faces_count(solid, samples):
    np.testing.assert_allclose(samples.distance, solid.distances(samples.space.astype(float)), atol=1e-5)


def test_a_floater_is_hunted_down(composite):
    # Networks whose heights are constant, the far above the near: everything in the boxes is inside.
    nets = networks(width=6)
    nets.theta.zero_()
    nets.theta[:, -2:] = torch.tensor([-2.0, 2.0])
    assert composite.strays(nets) > 10_000
    tune(nets, composite, 512, 1, 1e-9, 0, lambda step, loss: None, Deadline())
    assert composite._suspects[0] > 1000
    _, off = composite.draw(10, 400, np.random.default_rng(0))
    assert (off >= composite.n_space).sum() == 100
    _, off = composite.rows(composite.draw_batches(10, 400, 3, np.random.default_rng(0)).part(2, 3))
    assert (off >= composite.n_space).sum() == 100
    inverted = nets.copy()
    inverted.theta[:, -2:] = torch.tensor([2.0, -2.0])
    assert len(composite.hunt.floaters(inverted, 0.0)) == 0
    assert composite.strays(inverted) > 1000  # the whole solid is cut away


@pytest.mark.parametrize("cut", [True, False])
def test_what_is_wrong_near_the_surface_is_found(samples, far, frames, solid, cut):
    composite = Composite(samples, far, frames, CPU, Team(1))
    nets = networks(width=6)
    nets.theta.zero_()
    # Everything is cut away, or nothing.
    nets.theta[:, -2:] = torch.tensor([0.5, -0.5] if cut else [-2.0, 2.0])
    wrong, right = (composite.hunt.doubtful(nets, side) for side in ((1, 0) if cut else (0, 1)))
    assert len(wrong[0]) > 1000
    assert (wrong[1] < 0).all()
    assert len(right[0]) == 0
    composite.look(nets, REACH)
    assert composite._suspects[int(not cut)] == 0
    rows = composite.n_space + int(cut) * SUSPECTS + torch.arange(min(composite._suspects[int(cut)], SUSPECTS))
    assert len(rows) > 1000
    assert (composite._inside[rows] == cut).all()
    points = (composite._space[0][rows] @ composite._rotations[0].T).numpy().astype(float)
    assert np.sqrt(igl.point_mesh_squared_distance(points, solid.vertices, solid.faces)[0]).min() > 0.02
    assert (solid.contains(points) == cut).mean() > 0.99
    # The next search looks around what was found, too.
    assert [len(known) for known in composite.hunt.known] == ([0, 2000] if cut else [2000, 0])
    assert len(composite.hunt.doubtful(nets, int(cut))[0]) > 1000


def test_the_joint_fit_lowers_the_loss_and_keeps_what_is_held(composite, samples, far, frames):
    nets = networks()
    losses: list[float] = []
    held = torch.zeros(nets.theta.shape, dtype=torch.bool)
    held[0, 100:300] = True
    tune(nets, composite, 512, 200, 3e-3, 0, lambda step, loss: losses.append(loss), Deadline(), held)
    assert losses[-1] < losses[0]
    start = networks()
    fresh = Composite(samples, far, frames, CPU, Team(1))
    batch = fresh.draw_batches(5000, 5000, 1, np.random.default_rng(1))
    assert fresh.gradient(nets, batch)[1] < 0.3 * fresh.gradient(start, batch)[1]
    assert torch.equal(nets.theta[held], start.theta[held])
    assert (nets.theta[~held] != start.theta[~held]).float().mean() > 0.99


def test_wide_networks_take_smaller_steps(composite, monkeypatch):
    rates: list[np.ndarray] = []
    monkeypatch.setattr(Soap, "step", lambda self, gradient, rate: rates.append(rate))
    largest = []
    for width in (6, 20, 40):
        rates.clear()
        tune(of_widths(width, 5), composite, 64, 100, 1e-3, 0, lambda step, loss: None, Deadline())
        largest.append(np.max(rates))
    assert largest[1] == largest[0]
    assert largest[2] == pytest.approx(0.25 * largest[0])


def test_a_network_that_owns_little_takes_smaller_steps_and_all_begin_with_small_ones(composite, monkeypatch):
    rates: list[np.ndarray] = []
    monkeypatch.setattr(Soap, "step", lambda self, gradient, rate: rates.append(rate))
    nets = networks()
    composite.look(nets, REACH)
    owned = composite.owned
    assert owned.sum() == pytest.approx(1)
    tune(nets, composite, 64, 100, 1e-3, 0, lambda step, loss: None, Deadline())
    share = np.clip(2 * owned, LEAST_RATE, 1)
    assert share.min() < 1
    assert rates[0] == pytest.approx(1e-3 * share / 5)  # of the 5 first steps
    assert rates[4] == pytest.approx(1e-3 * share, rel=0.01)
    assert rates[-1].max() < 1e-6


def test_a_deadline_ends_the_joint_fit(composite):
    steps: list[int] = []
    start = time.monotonic()
    tune(networks(), composite, 64, 10**7, 1e-3, 0, lambda step, loss: steps.append(step), Deadline(1.0))
    assert time.monotonic() - start < 20
    assert len(steps) < 10**5


def test_the_matrix_does_not_depend_on_threads(composite):
    with Team(1) as one, Team(3) as three:
        whole = np.ones(networks(11).theta.shape, dtype=bool)
        a, b = (blocks(networks(11), composite, 0, team, whole) for team in (one, three))
    free = np.arange(a[0].shape[0]) % 3 == 0
    part = blocks(networks(11), composite, 0, Team(1), np.stack([free, ~free]))
    for x, y, z, mask in zip(a, b, part, (free, ~free), strict=True):
        assert np.array_equal(x, y)
        assert np.array_equal(x, x.T)
        assert np.linalg.eigvalsh(x).min() > -1e-6 * np.trace(x)
        np.testing.assert_allclose(z, x[np.ix_(mask, mask)], rtol=1e-4, atol=1e-5 * np.abs(x).max())


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


def test_symbols_stay_in_range():
    # A weight that feedback drives past the largest symbol stops there.
    H = np.array([[1.0, 0.999], [0.999, 1.0]])
    theta, step = np.array([MAX_SYMBOL + 0.4, MAX_SYMBOL + 0.4]) * 1e-3, np.full(2, 1e-3)
    rounded = rounding._round_in_order(theta, H, step, np.array([0, 1]), 2)
    assert np.abs(rounded / step).max() <= MAX_SYMBOL + 1e-6
    nets = networks()
    codes = rounding.step_codes(nets, np.full((2, 14), -30.0), 40.0)
    for k in range(2):
        for tensor, code in zip(nets.tensors(k), codes[k], strict=True):
            assert float(tensor.abs().max()) * 2 ** (int(code) / 4) < MAX_SYMBOL / 1.6


@pytest.mark.parametrize(("together", "widths", "parts"), [(100, (8, 8), 5), (10_000, (8, 8), 1), (200, (8, 5), 3)])
def test_rounded_networks_are_multiples_of_their_steps(composite, monkeypatch, together, widths, parts):
    monkeypatch.setattr(rounding, "TOGETHER", together)
    nets = of_widths(*widths)
    assert len(rounding._parts(nets)) == parts
    assert (rounding._parts(nets).sum(axis=0) == used(nets)).all()
    with Team(2) as team:
        matrices = rounding.sensitivities(nets, composite, 0, team)
        logs = rounding.relative_steps(nets, matrices)
        codes = rounding.step_codes(nets, logs, 5.0)
        rounding.round_networks(nets, composite, SMALL, codes, matrices, 0, team, lambda step, loss: None, Deadline())
    for k, of_net in enumerate(codes):
        for tensor, code in zip(nets.tensors(k), of_net, strict=True):
            symbols = tensor.double() * 2 ** (int(code) / 4)
            torch.testing.assert_close(symbols, symbols.round(), atol=1e-2, rtol=0)
    assert not nets.theta[torch.from_numpy(~used(nets))].any()
    records = joint._records(nets, codes, composite._frames)
    assert [r.width for r in records] == list(widths)
    for k, record in enumerate(records):
        # The same heights, whatever the order of the neurons.
        tensors = [s * 2.0 ** (-code / 4) for s, code in zip(record.symbols, record.step_codes, strict=True)]
        uv = np.random.default_rng(k).uniform(-0.5, 0.5, (50, 2)).astype(np.float32)
        got = Network([t.astype(np.float32) for t in tensors], 30, 30)(uv)
        with torch.no_grad():
            np.testing.assert_allclose(got, heights(nets, k, torch.from_numpy(uv)), atol=2e-3)


def test_soap_steps_networks_of_any_widths_as_it_would_each():
    together = of_widths(7, 12)
    alone = [initialise(w, 5, 30.0, torch.Generator().manual_seed(k)) for k, w in enumerate((7, 12))]
    optimisers = Soap(together), [Soap(a) for a in alone]
    rng = torch.Generator().manual_seed(1)
    for _ in range(25):
        gradient = torch.randn(together.theta.shape, generator=rng) * torch.from_numpy(used(together))
        optimisers[0].step(gradient, 1e-3)
        for k, one in enumerate(optimisers[1]):
            one.step(gradient[k : k + 1, : alone[k].counts[0]], 1e-3)
    for k in range(2):
        torch.testing.assert_close(together.row(k), alone[k].row(0), rtol=0, atol=2e-5)


def test_axes_are_chosen_by_what_they_leave(solid):
    costs = AxisCosts(solid, 0, Team(1))
    (first,) = costs.best(1)
    # The T's silhouette is along y; every other axis fills something in or sees more of it slantwise.
    assert abs(costs.axes[first][1]) > 0.5
    assert costs.mean_cost(costs.best(2)) < costs.mean_cost([first])
    free, *others = costs.sets(2)
    assert free == costs.best(2)
    aligned = set(range(len(costs.axes) - 6, len(costs.axes)))
    assert aligned & set(free) or aligned & set(others[0])
    assert all(costs.mean_cost(free) <= costs.mean_cost(o) for o in others)
    assert costs.visible == pytest.approx(1, abs=0.01)
    assert sum(costs.shares(costs.best(3))) == pytest.approx(1)


def test_a_longer_trial_decides_between_the_best_sets_of_axes(solid, monkeypatch):
    short: list[joint.Plan] = []
    long: list[joint.Plan] = []

    def trial(job, plan, steps, deadline, start):
        assert start == (None if steps == SMALL.trial_steps else plan.shares[0])
        tried, errors = (short, (0.2, 0.1)) if steps == SMALL.trial_steps else (long, (0.09, 0.05))
        tried.append(plan)
        # The first set looks bad at once, and the better of those tried for longer is the second.
        return joint.Trial(
            plan.floor + errors[min(len(tried) - 1, 1)], [1.0] * (len(plan.frames) - 1) + [0.2], plan.shares[0]
        )

    monkeypatch.setattr(joint, "_trial", trial)
    job = job_of(solid, replace(SMALL, target_size=16384))
    plan = joint.make_plan(job, Deadline())
    assert len(short) > len(long) == joint.FINALISTS
    assert all(p is not short[0] for p in long)
    assert plan.frames is long[1].frames
    # The widths follow what each field answered for in the trial.
    assert plan.widths == widths_for(job.settings, plan.shares, 30) != long[1].widths
    assert plan.widths[-1] < plan.widths[0]


def test_threads_do_not_change_which_trials_count(solid, monkeypatch):
    # The second plan is spared by the first one, though beside it there is a thread for it.
    floors, tried = [0.01, 0.3, 0.02, 0.25, 0.2], []
    plans = [joint.Plan([None] * 2, [0.5] * 2, [9] * 2, floor, 1.0, 1.0) for floor in floors]

    def trial(job, plan, steps, deadline, start):
        tried.append(plan.floor)
        return joint.Trial(plan.floor + 0.1, plan.shares, None)

    monkeypatch.setattr(joint, "_trial", trial)
    results = []
    for threads in (1, 2, 5):
        tried.clear()
        with Team(threads) as team:
            job = replace(job_of(solid, SMALL), team=team)
            results.append(joint._compare(job, plans, [None] * 5, 10, 1.0, Deadline(), 0, lambda done, error: None))
        assert sorted(tried) == ([0.01, 0.02] if threads == 1 else [0.01, 0.02, 0.3])
    errors = results[0][0]
    assert errors == pytest.approx([0.11, np.inf, 0.12, np.inf, np.inf])
    assert all(r[0] == errors for r in results)


def test_of_equal_trials_the_one_with_more_axes_is_chosen(solid, monkeypatch):
    monkeypatch.setattr(joint, "_trial", lambda job, plan, steps, deadline, start: joint.Trial(0.1, plan.shares, None))
    monkeypatch.setattr(AxisCosts, "floor", lambda self, chosen: 0.01)
    job = job_of(solid, replace(SMALL, target_size=4096, max_axes=3))
    assert len(joint.make_plan(job, Deadline()).frames) == 3


def test_a_network_that_no_sample_pulls_at_is_idle(composite, monkeypatch):
    real = Composite.look

    def look(self, nets, reach):
        real(self, nets, reach)
        for near in (self._near_surface, self._in_pool[1]):
            near[:, 1] = False

    monkeypatch.setattr(Composite, "look", look)
    nets, quiet = networks(), lambda step, loss: None
    with pytest.raises(IdleNetworkError) as found:
        tune(nets, composite, 64, 1000, 1e-3, 0, quiet, Deadline())
    assert found.value.number == 1
    # Between rounds all of its weights may be held.
    tune(nets, composite, 64, 1000, 1e-3, 0, quiet, Deadline(), torch.zeros(nets.theta.shape, dtype=torch.bool))


def test_an_idle_field_is_left_out_and_the_others_are_wider(solid, frames, monkeypatch):
    tried: list[joint.Plan] = []

    def fit(job, plan, deadline):
        tried.append(plan)
        if len(plan.frames) == 2:
            raise IdleNetworkError(0)
        return "networks", "composite", 0.0

    monkeypatch.setattr(joint, "fit_plan", fit)
    monkeypatch.setattr(joint, "fit_together", lambda job, plan, start, deadline: fit(job, plan, deadline))
    job = job_of(solid, replace(SMALL, target_size=4096))
    first = plan_of(job, frames[:2], [0.3, 0.7])
    plan, *rest = joint.fit_needed(job, first, Deadline())
    assert rest == ["networks", "composite", 0.0]
    assert plan is tried[1]
    assert plan.frames == [frames[1]]
    assert plan.shares == [0.7]
    assert plan.widths == widths_for(job.settings, [0.7], 30) > [max(first.widths)]
    # A trial says that such a set of axes is not worth its bytes.
    trial = joint._trial(job, first, 10, Deadline(), networks())
    assert trial.error == np.inf
    assert trial.shares == first.shares


def test_a_network_that_hardly_matters_is_not_rounded_to_nothing():
    nets = networks(count=2)
    size = nets.theta.shape[1]
    logs = relative_steps(nets, [[np.eye(size), 1e-12 * np.eye(size)]])
    sizes = np.array(nets.sizes(0)) / size
    assert (logs[1] - logs[0]) @ sizes == pytest.approx(COARSEST)
    codes = step_codes(nets, logs, 6.0)
    assert (codes[0] - codes[1]).max() <= COARSEST * STEPS_PER_OCTAVE + 1


def test_the_widths_follow_from_the_size_and_the_shares():
    def at(size: int, *shares: float) -> list[int]:
        widths = widths_for(replace(SMALL, target_size=size), list(shares), 30)
        room = (0.98 * size - 60 - 30 - 54 * len(shares)) * 8 / SMALL.bits
        weights = [parameter_count(w, SMALL.hidden_layers) for w in widths]
        assert sum(weights) <= room
        # There is no room for another neuron: in any, or, while all are to be equally wide, in each of them.
        more = [parameter_count(w + 1, SMALL.hidden_layers) - n for w, n in zip(widths, weights, strict=True)]
        assert sum(weights) + (min(more) if max(widths) > joint.OUTLINE else sum(more)) > room
        return widths

    assert at(1024, 0.9, 0.1) == at(1024, 0.5, 0.5) < at(4096, 0.5, 0.5) == at(4096, 0.1, 0.9)
    equal = at(16384, 0.5, 0.5)
    assert max(equal) - min(equal) <= 1
    large, small = at(16384, 0.9, 0.1)
    assert at(16384, 1.0)[0] > large > max(equal) > small > joint.OUTLINE
    assert at(16384, 0.1, 0.9) == [small, large]
    # What has next to nothing to do has an outline, too.
    assert at(16384, 0.5, 0.5, 0.0, 0.0)[2:] == [joint.OUTLINE] * 2
    assert widths_for(replace(SMALL, target_size=256), [0.5, 0.5], 30) == []
    assert widths_for(replace(SMALL, target_size=None, width=4), [0.9, 0.1], 30) == [4, 4]


def test_shares_of_the_loss(composite):
    nets = networks()
    shares = composite.shares(nets)
    assert sum(shares) == pytest.approx(1)
    surface, space = (torch.arange(n) for n in (composite.n_surface, composite.n_space))
    with torch.no_grad():
        terms = composite.terms(nets, surface, space)
    weight = torch.cat([torch.full((len(part),), 1 / len(part)) for part in (surface, space)])
    own = terms.dhf == 0
    assert shares[0] == pytest.approx(float((terms.cost * weight)[own].sum() / (terms.cost * weight).sum()), rel=1e-4)


def test_a_width_is_taken_as_given(solid):
    # 4 is the least that the options allow, less than what a size would be met with.
    plan = joint.make_plan(job_of(solid, replace(SMALL, target_size=None, width=4, trial_steps=0)), Deadline())
    assert plan.widths == [4] * len(plan.frames)


@pytest.mark.parametrize(("width", "omega"), [(16, 30), (32, 40), (40, 45)])
def test_wide_networks_have_a_larger_omega(solid, frames, width, omega):
    few = replace(SMALL, steps=3, tune_steps=3, samples=2000, target_resolution=32, far_cells=8)
    job = job_of(solid, few)
    plan = replace(plan_of(job, frames, [0.5, 0.5]), widths=[width, 8])
    fitted, _, _ = joint.fit_plan(job, plan, Deadline())
    assert fitted.omegas == (omega, 30)
    records = joint._records(fitted, joint._finest(fitted), frames)
    assert [(r.width, r.omega_first, r.omega_hidden) for r in records] == [(width, omega, omega), (8, 30, 30)]


@pytest.mark.parametrize("size", [900, 2500])
def test_a_target_size_is_met(creature, monkeypatch, size):
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
