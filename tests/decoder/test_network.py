"""The network against the formula, in float64 and one neuron at a time."""

from __future__ import annotations

import math

import analytic
import numpy as np
import pytest

from cndhf_codec.decoder.dhf import network
from cndhf_codec.decoder.dhf.field import Dhf
from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.decoder.dhf.table import HeightBounds, HeightTable
from cndhf_codec.format.container import tensor_shapes


def by_hand(tensors, uv, omega_first, omega_hidden) -> list[float]:
    x = [float(k) for k in uv]
    pairs = list(zip(tensors[0::2], tensors[1::2], strict=True))
    for layer, (W, b) in enumerate(pairs):
        sums = [sum(float(w) * k for w, k in zip(row, x, strict=True)) + float(c) for row, c in zip(W, b, strict=True)]
        omega = omega_first if layer == 0 else omega_hidden
        x = sums if layer == len(pairs) - 1 else [math.sin(omega * s) for s in sums]
    return x


@pytest.mark.parametrize(("width", "hidden"), [(1, 1), (7, 2), (12, 5)])
def test_network_is_the_formula(width, hidden):
    rng = np.random.default_rng(width)
    # Magnitudes of a fitted SIREN: large arguments of the sine would lose float32 precision on any machine.
    tensors = [rng.uniform(-1, 1, s).astype(np.float32) / max(s[-1], 4) for s in tensor_shapes(width, hidden)]
    uv = rng.uniform(-1, 1, (40, 2)).astype(np.float32)
    got = Network(tensors, 30, 11)(uv)
    assert got.shape == (40, 2)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, [by_hand(tensors, p, 30, 11) for p in uv], atol=2e-4)


def test_chunks_join_seamlessly(monkeypatch):
    dhf = Dhf(analytic.waves(1))
    uv = np.random.default_rng(0).uniform(-0.5, 0.5, (100, 2)).astype(np.float32)
    whole = dhf.network(uv)
    monkeypatch.setattr(network, "VALUES_AT_ONCE", 70)
    np.testing.assert_allclose(dhf.network(uv), whole, atol=1e-6)


def test_no_points():
    assert Dhf(analytic.waves(1)).network(np.empty((0, 2), np.float32)).shape == (0, 2)


def test_heights_are_those_of_the_nearest_point_of_the_domain():
    m = analytic.model(analytic.waves(2))
    (u0, u1), (v0, v1), _ = m.container.dhfs[0].bounds
    assert m.heights(0, [u1 + 5, v0 - 3]).tolist() == m.heights(0, [u1, v0]).tolist()
    assert m.heights(0, [u0 - 0.1, 0.1]).tolist() == m.heights(0, [u0, 0.1]).tolist()
    assert m.heights(0, [0.1, v1 + 0.1]).tolist() != m.heights(0, [0.1, v1 - 0.1]).tolist()


def test_table_is_close_to_the_network_and_exact_at_its_nodes():
    dhf = Dhf(analytic.waves(3))
    uv = np.random.default_rng(0).uniform(-1, 1, (2000, 2)).astype(np.float32)  # some outside the domain
    exact = dhf.heights(uv)
    errors = [np.abs(np.column_stack(HeightTable(dhf, spacing)(*uv.T)) - exact).max() for spacing in (0.16, 0.08, 0.04)]
    # Bilinear: half the spacing is a quarter of the error.
    assert errors[0] < 0.02
    assert errors[1] < errors[0] / 2.5
    assert errors[2] < errors[1] / 2.5
    table = HeightTable(dhf, 0.2)
    nodes = table.lo + table.step * np.stack(np.indices(table.shape), axis=-1).astype(np.float32)
    at_nodes = dhf.heights(nodes.reshape(-1, 2)).reshape(nodes.shape)
    np.testing.assert_allclose(table.values, np.moveaxis(at_nodes, -1, 0), atol=1e-5)


def test_table_nodes_are_no_farther_apart_than_asked_and_reach_the_edge():
    dhf = Dhf(analytic.waves(3))
    table = HeightTable(dhf, 0.4)
    assert table.step.max() <= 0.4
    np.testing.assert_allclose(table.lo + table.step * (table.shape - 1), dhf.bounds[:2, 1], atol=1e-5)


@pytest.mark.parametrize("size", [(0.01, 0.02), (0.2, 0.1), (0.7, 1.1)])
def test_bounds_hold_everywhere_in_a_rectangle(size):
    table = HeightTable(Dhf(analytic.waves(3)), 0.05)
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1.2, 1.2, (300, 2)).astype(np.float32)  # some outside the domain
    points = corners[:, None] + rng.uniform(0, 1, (300, 400, 2)) * size
    near, far = (x.reshape(300, 400) for x in table(*points.reshape(-1, 2).T.astype(np.float32)))
    bounds = HeightBounds(table, np.array(size, dtype=np.float32))(*corners.T)
    assert np.all(bounds[0] <= near.min(axis=1))
    assert np.all(bounds[1] <= far.min(axis=1))
    assert np.all(bounds[2] >= near.max(axis=1))
    assert np.all(bounds[3] >= far.max(axis=1))
    # And they are bounds of little more than the rectangle.
    wider = HeightBounds(table, 1.5 * np.array(size, dtype=np.float32) + 0.2)(*(corners.T - np.float32(0.1)))
    assert np.all(wider[0] <= bounds[0] + 1e-6)
    assert np.all(wider[3] >= bounds[3] - 1e-6)


def test_gradient_is_the_slope_of_the_heights():
    rng = np.random.default_rng(3)
    tensors = [rng.uniform(-1, 1, s) / max(s[-1], 4) for s in tensor_shapes(9, 3)]
    uv = rng.uniform(-1, 1, (50, 2))
    net = Network([t.astype(np.float32) for t in tensors], 12, 8)
    heights, slopes = net.gradient(uv.astype(np.float32))
    np.testing.assert_allclose(heights, net(uv.astype(np.float32)), atol=1e-6)
    # Central differences of the formula in float64.
    step = 1e-5
    for j in range(2):
        ahead, behind = uv.copy(), uv.copy()
        ahead[:, j] += step
        behind[:, j] -= step
        expected = [
            (np.array(by_hand(tensors, a, 12, 8)) - by_hand(tensors, b, 12, 8)) / (2 * step)
            for a, b in zip(ahead, behind, strict=True)
        ]
        np.testing.assert_allclose(slopes[:, :, j], expected, atol=1e-3)


@pytest.mark.parametrize("width", [3, 40])
def test_any_number_of_rows(width, monkeypatch):
    rng = np.random.default_rng(width)
    tensors = [rng.uniform(-0.3, 0.3, s).astype(np.float32) for s in tensor_shapes(width, 2)]
    net, uv = Network(tensors, 5, 3), rng.uniform(-1, 1, (1001, 2)).astype(np.float32)
    one_by_one = np.concatenate([net(p[None]) for p in uv])
    monkeypatch.setattr(network, "VALUES_AT_ONCE", 300 * width)  # several threads
    np.testing.assert_allclose(net(uv), one_by_one, atol=1e-5)
    np.testing.assert_allclose(net.gradient(uv)[0], one_by_one, atol=1e-5)
    assert net(uv[:0]).shape == (0, 2)
    assert net.gradient(uv[:0])[1].shape == (0, 2, 2)
