"""Thin solids: how thick they are, and that a grid which tears them warns."""

from __future__ import annotations

import warnings
from contextlib import suppress

import analytic
import numpy as np
import pytest
from analytic import ABOUT_Y_90, slab

from cndhf_codec import load
from cndhf_codec.decoder.dhf.thickness import thickness
from cndhf_codec.errors import SurfaceError

THIN = 2**-9


def plate():
    """1 x 1 x 1/512, in one field or as the intersection with a field from the side."""
    return analytic.model(slab((-0.5, -0.5, 0), (0.5, 0.5, THIN)), scale=8.0)


def rail():
    """1 x 1/512 x 1/512."""
    return analytic.model(
        slab((-0.5, -THIN / 2, -0.25), (0.5, THIN / 2, 0.25)),
        slab((-0.25, -0.5, -0.5), (THIN - 0.25, 0.5, 0.5), ABOUT_Y_90),
    )


def test_the_thickness_of_a_plate():
    found = thickness(plate()._shape.solid.dhfs)
    assert found is not None
    assert found.longest == pytest.approx(1, rel=0.02)
    assert (found.least, found.typical) == pytest.approx((THIN, THIN), rel=1e-3)
    assert found.resolution == pytest.approx(512, rel=0.02)


def test_ordinary_solids_are_not_thin(golden):
    for path in golden.glob("*.cndhf"):
        model = load(path)
        if model.representation == "surface":
            continue
        found = thickness(model._shape.solid.dhfs)
        assert found is None or found.resolution < 256


def test_by_default_a_thin_plate_is_whole():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = plate().to_mesh()
    assert mesh.is_watertight
    assert len(mesh.split()) == 1
    assert mesh.volume == pytest.approx(8**3 * THIN, rel=1e-3)


@pytest.mark.parametrize(
    "ask",
    [lambda m: m.to_mesh(500), lambda m: m.to_mesh(method="marching-cubes"), lambda m: m.occupancy(256)],
    ids=["resolution", "method", "occupancy"],
)
def test_a_grid_that_is_too_coarse_says_so(ask):
    message = r"0\.0156 thick, are thinner than a cell of resolution \d+ .*, or a resolution of 50\d and more"
    with pytest.warns(UserWarning, match=message), suppress(SurfaceError):  # a node falls into the plate, or none
        ask(plate())


@pytest.mark.encode
def test_a_grid_that_is_fine_enough_says_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plate().to_mesh(1100)
        plate().to_mesh(method="intersection")


def test_the_error_of_an_intersection_follows_the_thickness():
    model = plate()
    thin = model._shape.solid.thinner_than_a_cell(256)
    assert thin is not None
    assert np.isclose(thin.typical / 20, THIN / 20, rtol=1e-3)
    assert len(model.to_mesh().faces) == 12
