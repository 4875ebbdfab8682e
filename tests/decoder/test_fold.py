"""Mirrored height fields: the network describes one side of the middle of the box."""

from __future__ import annotations

from dataclasses import replace

import analytic
import numpy as np
import pytest
from analytic import ABOUT_Y_90, waves

from cndhf_codec.decoder.dhf.field import Dhf


@pytest.fixture(params=[1, 2, 3])
def fold(request) -> int:
    return request.param


def middles(record) -> np.ndarray:
    return record.bounds[:2].mean(axis=1)


def test_heights_are_those_of_the_upper_side(fold):
    record = waves(4, fold=fold)
    plain, folded = analytic.model(replace(record, fold=0)), analytic.model(record)
    uv = np.random.default_rng(0).uniform(-1, 1, (500, 2))
    # By hand, as the specification says it: clamp, then fold.
    lo, hi = record.bounds[:2].T
    there = np.clip(uv, lo, hi)
    for k in range(2):
        if fold >> k & 1:
            m = middles(record)[k]
            there[:, k] = m + np.abs(there[:, k] - m)
    np.testing.assert_allclose(folded.heights(0, uv), plain.heights(0, there), atol=1e-6)
    assert not np.allclose(folded.heights(0, uv), plain.heights(0, uv), atol=1e-3)
    # The middle of waves' box is not 0.
    assert (np.abs(middles(record)) > 0.01).all()


def test_the_solid_is_its_own_mirror_image(fold):
    record = waves(5, ABOUT_Y_90, fold)
    model = analytic.model(record, centre=(1, 2, 3), scale=2)
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (3000, 3))
    for k in range(2):
        axis = record.rotation[k]
        image = points - 2 * (points @ axis - middles(record)[k])[:, None] * axis
        same = np.abs(model.implicit(points * 2 + [1, 2, 3]) - model.implicit(image * 2 + [1, 2, 3])) < 1e-5
        assert same.all() == bool(fold >> k & 1)


def test_gradient(fold):
    dhf = Dhf(waves(6, fold=fold))
    p = np.random.default_rng(2).uniform(-0.5, 0.5, (400, 3)).astype(np.float32)
    f, gradient = dhf.implicit_gradient(p)
    np.testing.assert_allclose(f, dhf.implicit(p), atol=1e-6)
    h = np.float32(1e-3)
    by_steps = np.stack([(dhf.implicit(p + h * e) - dhf.implicit(p - h * e)) / (2 * h) for e in np.eye(3, dtype="f4")])
    off = np.abs(by_steps.T - gradient).max(axis=1)
    assert np.median(off) < 1e-3
    assert (off > 0.02).mean() < 0.03  # at creases, and at the mirror


def test_surfaces_agree(fold):
    model = analytic.model(waves(7, fold=fold), waves(8, ABOUT_Y_90))
    cubes, exact = model.to_mesh(96), model.to_mesh(method="intersection", max_error=0.002)
    assert cubes.is_watertight
    assert exact.is_watertight
    assert exact.volume == pytest.approx(cubes.volume, rel=5e-3)
    assert np.abs(model.implicit(cubes.vertices)).max() < 2e-3


def test_info_names_the_mirrors(fold):
    model = analytic.model(waves(7, fold=fold), waves(8))
    assert [d["mirrored"] for d in model.info["dhfs"]] == [[c for k, c in enumerate("uv") if fold >> k & 1], []]
