"""Gauss-Newton matrices, error feedback and step codes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jointly import SMALL, networks, of_widths, quiet, used

from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.network.siren import heights
from cndhf_codec.encoder.dhf.records import records_of
from cndhf_codec.encoder.dhf.rounding import feedback as rounding
from cndhf_codec.encoder.dhf.rounding.feedback import (
    COARSEST_OCTAVES,
    Rounding,
    gauss_newton_matrices,
    relative_steps,
    step_codes,
)
from cndhf_codec.encoder.dhf.rounding.gauss_newton import Draw, gauss_newton_blocks
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.format.constants import MAX_SYMBOL, STEPS_PER_OCTAVE

pytestmark = pytest.mark.encode


def test_the_matrix_does_not_depend_on_threads(joint_loss):
    with ThreadPool(1) as one, ThreadPool(3) as three:
        whole = np.ones(networks(11).theta.shape, dtype=bool)
        a, b = (gauss_newton_blocks(networks(11), joint_loss, Draw(0, 4.0), pool, whole) for pool in (one, three))
    free = np.arange(a[0].shape[0]) % 3 == 0
    part = gauss_newton_blocks(networks(11), joint_loss, Draw(0, 4.0), ThreadPool(1), np.stack([free, ~free]))
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
def test_rounded_networks_are_multiples_of_their_steps(joint_loss, monkeypatch, together, widths, parts):
    monkeypatch.setattr(rounding, "MOST_TOGETHER", together)
    nets = of_widths(*widths)
    assert len(rounding._parts(nets)) == parts
    assert (rounding._parts(nets).sum(axis=0) == used(nets)).all()
    with ThreadPool(2) as pool:
        matrices = gauss_newton_matrices(nets, joint_loss, Draw(0, 4.0), pool)
        logs = rounding.relative_steps(nets, matrices)
        codes = rounding.step_codes(nets, logs, 5.0)
        rounding.round_networks(nets, joint_loss, Rounding(SMALL, codes, matrices, 0), pool, quiet, Deadline())
    for k, of_net in enumerate(codes):
        for tensor, code in zip(nets.tensors(k), of_net, strict=True):
            symbols = tensor.double() * 2 ** (int(code) / 4)
            torch.testing.assert_close(symbols, symbols.round(), atol=1e-2, rtol=0)
    assert not nets.theta[torch.from_numpy(~used(nets))].any()
    records = records_of(nets, codes, joint_loss.store._frames)
    assert [r.width for r in records] == list(widths)
    for k, record in enumerate(records):
        # The same heights, whatever the order of the neurons.
        tensors = [s * 2.0 ** (-code / 4) for s, code in zip(record.symbols, record.step_codes, strict=True)]
        uv = np.random.default_rng(k).uniform(-0.5, 0.5, (50, 2)).astype(np.float32)
        got = Network([t.astype(np.float32) for t in tensors], 30, 30)(uv)
        with torch.no_grad():
            np.testing.assert_allclose(got, heights(nets, k, torch.from_numpy(uv)), atol=2e-3)


def test_a_network_that_hardly_matters_is_not_rounded_to_nothing():
    nets = networks(count=2)
    size = nets.theta.shape[1]
    logs = relative_steps(nets, [[np.eye(size), 1e-12 * np.eye(size)]])
    sizes = np.array(nets.sizes(0)) / size
    assert (logs[1] - logs[0]) @ sizes == pytest.approx(COARSEST_OCTAVES)
    codes = step_codes(nets, logs, 6.0)
    assert (codes[0] - codes[1]).max() <= COARSEST_OCTAVES * STEPS_PER_OCTAVE + 1
