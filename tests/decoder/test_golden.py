"""Frozen files decode as on the day they were written.

A missing or changed file is a failure: nothing here makes one. See golden/make.py.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from cndhf_codec import load, loads
from cndhf_codec.format.container import fold

NAMES = ["encoded.cndhf", "by-hand.cndhf"]


@pytest.fixture(params=NAMES)
def case(request, golden: Path) -> tuple[Path, dict]:
    return golden / request.param, json.loads((golden / "expected.json").read_text("utf-8"))[request.param]


def test_no_golden_file_was_added_or_lost(golden):
    assert sorted(p.name for p in golden.glob("*.cndhf")) == sorted([*NAMES, "surface.cndhf"])
    assert sorted(json.loads((golden / "expected.json").read_text("utf-8"))) == sorted(NAMES)


def test_the_file_is_unchanged(case):
    path, expected = case
    assert hashlib.sha256(path.read_bytes()).hexdigest() == expected["sha256"]


def test_stored_values(case):
    path, expected = case
    c = load(path).container
    assert [list(c.centre), c.scale] == [expected["centre"], expected["scale"]]
    m = c.metadata
    assert [m.encoder, m.mean_error, m.p99_error, m.max_error, m.source] == expected["metadata"]
    assert [list(d.step_codes) for d in c.dhfs] == expected["step_codes"]
    symbols = b"".join(s.astype("<i4").tobytes() for d in c.dhfs for s in d.symbols)
    assert hashlib.sha256(symbols).hexdigest() == expected["symbols_sha256"]


def test_decoded_values(case):
    path, expected = case
    model = load(path)
    for i, heights in enumerate(expected["heights"]):
        np.testing.assert_allclose(model.heights(i, expected["uv"]), heights, atol=1e-4)
    f = model.implicit(expected["points"])
    np.testing.assert_allclose(f, expected["implicit"], atol=1e-4 * expected["scale"])
    clear = np.abs(expected["implicit"]) > 1e-3 * expected["scale"]
    assert np.array_equal(model.contains(expected["points"])[clear], (np.array(expected["implicit"]) > 0)[clear])
    assert {True, False} == set(model.contains(expected["points"]).tolist())


def test_heights_keep_to_the_tolerance_of_the_specification(case):
    # Whatever the machine: within 1e-4 of exact arithmetic (here float64) on the dequantised weights, all over the box.
    path, _ = case
    model = load(path)
    for i, record in enumerate(model.container.dhfs):
        lo, hi = record.bounds[:2].T
        uv = lo + (hi - lo) * np.random.default_rng(i).uniform(0, 1, (3000, 2))
        uv = uv.astype(np.float32)
        *layers, last = zip(*[iter(t.astype(np.float64) for t in record.weights())] * 2, strict=True)
        x, omega = uv.astype(np.float64), record.omega_first
        fold(x, record.mirrors)
        for W, b in layers:
            x, omega = np.sin(omega * (x @ W.T + b)), record.omega_hidden
        np.testing.assert_allclose(model.heights(i, uv), x @ last[0].T + last[1], atol=1e-4, rtol=0)


def test_writing_again_keeps_the_values(case):
    path, expected = case
    model = load(path)
    again = loads(model.dumps())
    assert np.array_equal(again.implicit(expected["points"]), model.implicit(expected["points"]))
    assert again.container.metadata == model.container.metadata


def test_the_surface(golden):
    expected = json.loads((golden / "surface.json").read_text("utf-8"))
    data = (golden / "surface.cndhf").read_bytes()
    assert hashlib.sha256(data).hexdigest() == expected["sha256"]
    c = loads(data).container
    assert [list(c.centre), c.scale] == [expected["centre"], expected["scale"]]
    assert c.surface is not None
    assert [list(c.surface.quaternion), c.surface.step] == [expected["quaternion"], expected["step"]]
    assert c.surface.positions.tolist() == expected["positions"]
    assert c.surface.faces.tolist() == expected["faces"]
    assert c.surface.sharp.tolist() == expected["sharp"]
