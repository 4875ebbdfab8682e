"""Cells: what they decide without a network must agree with the networks."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from multiprocessing.pool import ThreadPool

import analytic
import numpy as np
import pytest
from analytic import ABOUT_Y_90, ABOUT_Z_45, slab, waves

from cndhf_codec import load
from cndhf_codec.decoder.dhf import cells, representation
from cndhf_codec.decoder.dhf.cells import SURELY_INSIDE, SURELY_OUTSIDE, CellGrid
from cndhf_codec.decoder.dhf.field import implicit_gradient

TURNED = (9000, -14000, 20000, 20000)


def rough():
    """Heights that rise and fall within every 0.03 units, with steep walls between."""
    record = waves(3)
    symbols = list(record.symbols)
    symbols[0] = symbols[0] * 60
    symbols[4] = symbols[4] * 4
    return replace(record, omega_first=30, symbols=tuple(symbols))


MODELS = {
    "box": lambda: analytic.model(slab((-0.5, -0.25, -0.125), (0.25, 0.5, 0.375), TURNED)),
    "two": lambda: analytic.model(waves(1), waves(2, ABOUT_Y_90), centre=(5, 6, 7), scale=3),
    "mirrored": lambda: analytic.model(waves(1, fold=1), waves(2, ABOUT_Y_90, fold=3)),
    "nine": lambda: analytic.model(*(waves(s, (TURNED, ABOUT_Z_45, ABOUT_Y_90)[s % 3]) for s in range(9))),
    "rough": lambda: analytic.model(rough()),
    "plate": lambda: analytic.model(slab((-0.5, -0.5, 0), (0.5, 0.5, 2**-10))),
    "speck": lambda: analytic.model(slab((0, 0, 0), (2**-12, 2**-12, 2**-12))),
    "empty": lambda: analytic.model(slab((-0.5, -0.5, -0.5), (-0.25, 0.5, 0.5)), slab((0.25, -0.5, -0.5), (0.5,) * 3)),
}


@pytest.fixture(params=[*MODELS, "fitted"])
def model(request, golden):
    return load(golden / "encoded.cndhf") if request.param == "fitted" else MODELS[request.param]()


def cloud(model, n=60_000):
    """Points in the model's box and around it, and some next to its surface, in input coordinates."""
    rng = np.random.default_rng(0)
    wide = rng.uniform(-1.2, 1.2, (n, 3))
    lo, hi = CellGrid(model._shape.solid.dhfs).box
    inner = rng.uniform(lo, hi, (n, 3))
    f, g = implicit_gradient(model._shape.solid.dhfs, inner.astype(np.float32))
    beside = inner - (f / np.maximum((g**2).sum(axis=1), 1e-6))[:, None] * g + rng.normal(0, 1e-3, (n, 3))
    return np.concatenate([wide, inner, beside]) * model.container.scale + model.container.centre


@pytest.mark.encode
def test_contains_is_the_sign_of_f(model):
    points = cloud(model)
    f = model.implicit(points) / model.container.scale
    model._shape.points_asked = representation.POINTS_WORTH_CELLS
    inside = model.contains(points)
    assert model._shape.solid.has_cells
    sure = np.abs(f) > 2e-6  # networks differ by that from one grouping of points to another
    assert np.array_equal(inside[sure], f[sure] >= 0)
    assert sure.mean() > 0.99


def test_cells_decide_most_points():
    model = MODELS["two"]()
    grid = CellGrid(model._shape.solid.dhfs)
    sure = (grid.states == SURELY_INSIDE) | (grid.states == SURELY_OUTSIDE)
    assert sure.mean() > 0.85
    assert (grid.states == SURELY_INSIDE).mean() > 0.1


def test_heights_too_rough_to_bound_are_asked_of_the_network():
    bounds = cells.PatchBounds(MODELS["rough"]()._shape.solid.dhfs[0])
    assert np.isinf(bounds.extrema.near_least).mean() > 0.001
    assert np.isfinite(cells.PatchBounds(MODELS["two"]()._shape.solid.dhfs[0]).extrema.near_least).all()


def test_bounds_hold_between_nodes(model):
    for dhf in model._shape.solid.dhfs:
        bounds = cells.PatchBounds(dhf)
        lo, hi = dhf.bounds[:2].T
        uv = np.random.default_rng(1).uniform(lo, hi, (200_000, 2)).astype(np.float32)
        at = tuple(np.clip(((uv - bounds.lo) / bounds.size).astype(int), 0, bounds.shape - 1).T)
        near, far = dhf.heights(uv).T
        near_least, near_greatest, far_least, far_greatest = (b[at] for b in bounds.extrema)
        assert np.all((near_least <= near) & (near <= near_greatest) & (far_least <= far) & (far <= far_greatest))


def test_small_questions_make_no_cells(golden):
    model = load(golden / "encoded.cndhf")
    points = cloud(model, 10)
    first = model.contains(points)
    assert not model._shape.solid.has_cells
    for _ in range(representation.POINTS_WORTH_CELLS // len(points)):
        model._shape.points_asked += len(points)  # as by asking so often
    assert np.array_equal(model.contains(points), first)
    assert model._shape.solid.has_cells


def test_points_anywhere():
    model = MODELS["two"]()
    model._shape.points_asked = representation.POINTS_WORTH_CELLS
    far = [
        [np.nan, 0, 0],
        [0, np.inf, 0],
        [0, 0, -np.inf],
        [1e300, 0, 0],
        [-1e30, 1e30, 1e30],
        [1e9, 6, 7],
        [-1e9, 6, 7],
    ]
    assert not model.contains(far).any()
    assert not model.contains(np.array(far, np.float64).clip(-1e38, 1e38).astype(np.float32)).any()
    inside = np.array(model.container.centre, np.float32)
    assert model.contains(inside).shape == ()
    assert model.contains(np.broadcast_to(inside, (3, 4, 5, 3))).all()
    assert model.contains(np.empty((2, 0, 3))).shape == (2, 0)


def test_float32_points_of_a_far_solid_are_taken_as_they_are():
    model = analytic.model(waves(1), centre=(1e5, 0, 0), scale=1.0)
    model._shape.points_asked = representation.POINTS_WORTH_CELLS
    points = np.random.default_rng(0).uniform(-1, 1, (20_000, 3)) + np.array([1e5, 0, 0])
    points = points.astype(np.float32)
    assert np.array_equal(model.contains(points), model.contains(points.astype(np.float64)))


@pytest.mark.encode
def test_many_threads_make_the_cells_once(monkeypatch):
    made = []

    class Counted(CellGrid):
        def __init__(self, dhfs):
            made.append(1)
            super().__init__(dhfs)

    monkeypatch.setattr(cells, "CellGrid", Counted)
    model = MODELS["two"]()
    points = cloud(model, 20_000)
    expected = model.implicit(points) >= 0
    origins, directions = points[:200], points[200:400] - points[:200]
    alone = MODELS["two"]().ray_intersect(origins, directions).distance
    made.clear()
    model._shape.points_asked = representation.POINTS_WORTH_CELLS

    def ask(_):
        return model.contains(points), model.ray_intersect(origins, directions).distance, model.implicit(points[:500])

    meshes = [MODELS["two"]().to_mesh(24), MODELS["two"]().to_mesh(24, method="intersection")]
    occupied = MODELS["two"]().occupancy(24)[0]

    def make(_):
        return model.to_mesh(24), model.to_mesh(24, method="intersection"), model.occupancy(24)[0]

    with ThreadPool(8) as pool:
        made_surfaces = pool.map_async(make, range(8))
        answers = pool.map(ask, range(16))
        for *ours, grid in made_surfaces.get():
            assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(ours, meshes, strict=True))
            assert np.array_equal(grid, occupied)
    assert len(made) == 1
    for inside, distance, _ in answers:
        assert (inside != expected).mean() < 1e-4
        np.testing.assert_array_equal(inside, answers[0][0])
        np.testing.assert_allclose(distance, alone, atol=1e-4)


def test_a_copy_of_a_model_makes_its_own_cells(golden):
    import copy
    import pickle

    model = load(golden / "encoded.cndhf")
    model._shape.solid.cells()
    for twin in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert not twin._shape.solid.has_cells
        assert twin.dumps() == model.dumps()
        assert twin.info == model.info


@pytest.mark.encode
@pytest.mark.parametrize("query", ["contains", "implicit", "gradient", "heights", "rays", "fan", "integers"])
def test_memory_does_not_grow_with_the_points(query):
    model = MODELS["two"]()
    points = (np.random.default_rng(0).uniform(-1, 1, (600_000, 3)) * 3 + 6).astype(np.float32)
    ask = {
        "contains": lambda: model.contains(points),
        "implicit": lambda: model.implicit(points),
        "gradient": lambda: model.implicit(points, gradient=True),
        "heights": lambda: model.heights(0, points[:, :2]),
        "rays": lambda: model.ray_intersect(points[:80_000], points[:80_000] - 6),
        "fan": lambda: model.ray_intersect(points[:400, None], points[:1000] - 6),
        "integers": lambda: model.implicit(np.array(points * 10, np.int16)),
    }[query]
    tracemalloc.start()
    try:
        kept = ask()  # noqa: F841 - what comes out does not count
        now, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak - now < 62e6
