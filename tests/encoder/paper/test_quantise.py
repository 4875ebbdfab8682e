"""Quantisation keeps its promise about the loss, in small symbols."""

from __future__ import annotations

from dataclasses import replace
from threading import Event

import numpy as np
import pytest
import trimesh

from cndhf_codec.decoder.dhf.network import Network
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.fit.single import Training, fit_single
from cndhf_codec.encoder.dhf.fit.targets import height_targets
from cndhf_codec.encoder.dhf.frames import frame_for_axis
from cndhf_codec.encoder.paper import quantise as quantise_module
from cndhf_codec.encoder.paper.quantise import quantise
from cndhf_codec.encoder.paper.settings import PaperSettings
from cndhf_codec.format import Container, dumps, loads
from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode

SETTINGS = PaperSettings(width=8, hidden_layers=2, margin=0.01)
TRAINING = Training(width=8, hidden_layers=2, omega=30, steps=300, learning_rate=3e-3, batch=512, margin=0.01)


@pytest.fixture(scope="module")
def targets():
    mesh = trimesh.creation.icosphere(4, 0.8)
    solid = Solid(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))
    return height_targets(solid, frame_for_axis(np.array([0.6, 0, 0.8]), solid.vertices), 48)


@pytest.fixture(scope="module")
def fitted(targets):
    network = fit_single(targets, TRAINING, 0, Deadline(), Event(), lambda *_: None)
    return [t.numpy() for t in network.tensors(0)]


@pytest.fixture(autouse=True)
def fewer_samples(monkeypatch):
    monkeypatch.setattr(quantise_module, "PROBE_POINTS", 2**13)


def height_error(tensors, targets) -> float:
    y = Network(tensors, 30, 30)(targets.uv.reshape(-1, 2))
    truth = np.stack([targets.near.ravel(), targets.far.ravel()], axis=1)
    return float(np.abs(y - truth)[targets.hit.ravel()].mean())


@pytest.mark.parametrize("allowed", [0.01, 0.2])
def test_the_error_grows_by_no_more_than_allowed(targets, fitted, allowed):
    record = quantise(fitted, targets, replace(SETTINGS, quantisation_loss=allowed), 0)
    # Measured on all pixels, where the encoder looks at a sample of them.
    assert height_error(record.weights(), targets) < height_error(fitted, targets) * (1 + 1.5 * allowed + 0.01)


def test_a_larger_allowance_gives_smaller_files(targets, fitted):
    sizes = [
        len(dumps(Container((0.0, 0.0, 0.0), 1.0, (quantise(fitted, targets, s, 0),))))
        for s in (replace(SETTINGS, quantisation_loss=q) for q in (0.003, 0.03, 0.3))
    ]
    assert sizes[0] > sizes[1] > sizes[2]


def test_the_record_is_what_the_format_wants(targets, fitted):
    record = quantise(fitted, targets, SETTINGS, 0)
    assert max(int(np.abs(s).max()) for s in record.symbols) <= 32767
    assert all(0 <= code <= 127 for code in record.step_codes)
    assert (record.quaternion, record.box) == (targets.frame.quaternion, targets.frame.box)
    assert (record.width, record.hidden_layers, record.omega_first, record.omega_hidden) == (8, 2, 30, 30)
    (back,) = loads(dumps(Container((0.0, 0.0, 0.0), 1.0, (record,)))).dhfs
    for w, tensor, code in zip(back.weights(), fitted, record.step_codes, strict=True):
        # Rounding to nearest: no weight is off by more than half a step.
        assert np.abs(w - tensor).max() <= 0.51 * 2 ** (-code / 4)


def test_large_and_zero_weights_fit_the_symbols(targets, fitted):
    odd = [t.copy() for t in fitted]
    odd[-1][:] = 500.0  # an output bias far outside what a step of 2^-31 could say in 16 bits
    odd[1][:] = 0
    record = quantise(odd, targets, SETTINGS, 0)
    dumps(Container((0.0, 0.0, 0.0), 1.0, (record,)))  # refuses symbols out of range
    np.testing.assert_allclose(record.weights()[-1], 500, rtol=1e-3)
    assert not record.weights()[1].any()


def test_equal_seeds_give_equal_records(targets, fitted):
    a, b = (quantise(fitted, targets, SETTINGS, 3) for _ in range(2))
    assert a.step_codes == b.step_codes
    assert all(np.array_equal(x, y) for x, y in zip(a.symbols, b.symbols, strict=True))
