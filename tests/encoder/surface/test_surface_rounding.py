"""Rounding to the grid with feedback, and the choice of sharp edges."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from control_meshes import NO_EDGES, arrays, mean_distance, target_of

from cndhf_codec.encoder.surface.basis import basis_of
from cndhf_codec.encoder.surface.fit import fit
from cndhf_codec.encoder.surface.rounding import Rounding, polished


@pytest.fixture(scope="module")
def fitted():
    """(basis, finer basis to measure with, target, control): a bumpy ball, fitted."""
    ball = trimesh.creation.icosphere(4)
    ball.vertices *= 1 + 0.1 * np.sin(4 * ball.vertices[:, [0]]) * np.cos(3 * ball.vertices[:, [1]])
    target = target_of(ball)
    mesh = arrays(trimesh.creation.icosphere(2))
    basis = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, 2)
    finer = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, 4)
    return basis, finer, target, fit(basis, target, mesh.vertices, 8)


def test_plain_numbers_near_the_control_vertices(fitted):
    basis, _, target, control = fitted
    kept = control.copy()
    rounding = Rounding(basis, target, control)
    for step in (0.001, 0.03):
        grid = rounding.to(step)
        assert (grid.dtype, grid.shape) == (np.int64, control.shape)
        # A vertex moves along the surface for the sake of the others, but not far.
        assert np.abs(step * grid - control).max() < 10 * step + 0.01
    np.testing.assert_array_equal(control, kept)


def test_feedback_is_better_than_the_nearest_grid_point(fitted):
    basis, finer, target, control = fitted
    rounding = Rounding(basis, target, control)
    exact = mean_distance(target, finer.surface(control), finer.fine)
    for step in (0.01, 0.03):
        plain = mean_distance(target, finer.surface(step * np.rint(control / step)), finer.fine) - exact
        fed_back = mean_distance(target, finer.surface(step * rounding.to(step)), finer.fine) - exact
        assert fed_back < 0.7 * plain


def test_a_fine_grid_changes_nothing_but_the_last_digits(fitted):
    basis, finer, target, control = fitted
    surface = finer.surface(control)
    moved = finer.surface(1e-5 * Rounding(basis, target, control).to(1e-5))
    exact = mean_distance(target, surface, finer.fine)
    assert mean_distance(target, moved, finer.fine) == pytest.approx(exact, rel=0.02)


def test_stiffness(fitted):
    basis, finer, target, control = fitted
    rounding = Rounding(basis, target, control)
    assert rounding.stiffness > 0
    # Measured at the samples that were fitted, so a little smaller than elsewhere.
    assert rounding.mean == pytest.approx(mean_distance(target, finer.surface(control), finer.fine), rel=0.2)
    assert 0.3 * rounding.mean < rounding.median < 3 * rounding.mean


def test_it_repeats(fitted):
    basis, _, target, control = fitted
    grids = [Rounding(basis, target, control).to(0.01).tobytes() for _ in range(2)]
    assert grids[0] == grids[1]
    rounding = Rounding(basis, target, control)
    rounding.to(0.05)
    assert rounding.to(0.01).tobytes() == grids[0]


@pytest.mark.parametrize("step", [0.01, 0.03])
def test_polishing_takes_a_part_of_the_error_of_rounding_away(fitted, step):
    basis, finer, target, control = fitted
    grid = Rounding(basis, target, control).to(step)
    kept = grid.copy()
    better = polished(basis, target, grid, step)
    np.testing.assert_array_equal(grid, kept)
    assert better.dtype == np.int64
    np.testing.assert_array_equal(polished(basis, target, grid, step), better)

    def error(points: np.ndarray) -> float:
        return mean_distance(target, finer.surface(points), finer.fine)

    assert error(step * better) - error(control) < 0.9 * (error(step * grid) - error(control))


def test_polishing_leaves_alone_what_is_best(fitted):
    basis, _, target, control = fitted
    once = polished(basis, target, Rounding(basis, target, control).to(0.03), 0.03)
    again = polished(basis, target, once, 0.03)
    assert np.mean(once != polished(basis, target, again, 0.03)) < 0.2


def test_a_price_makes_coordinates_repeat_and_costs_little():
    # A box with further vertices on its faces and edges, which may slide there.
    box = trimesh.creation.box((0.9, 0.7, 0.5)).subdivide().subdivide()
    rng = np.random.default_rng(3)
    jittered = box.vertices + np.where(np.abs(box.vertices) < [0.44, 0.34, 0.24], rng.uniform(-0.03, 0.03, (98, 3)), 0)
    mesh, target = arrays(box), target_of(box)
    sharp = np.asarray(box.edges_unique)
    basis = basis_of(mesh.faces, len(mesh.vertices), sharp, 2)
    rounding = Rounding(basis, target, np.asarray(jittered))

    def repeated(grid):
        """The share of coordinates that a neighbour has."""
        same = grid[sharp[:, 0]] == grid[sharp[:, 1]]
        out = np.zeros(grid.shape, dtype=bool)
        np.logical_or.at(out, sharp[:, 0], same)
        np.logical_or.at(out, sharp[:, 1], same)
        return out.mean()

    step = 2.0**-9
    price = 10 * rounding.stiffness * step**2
    plain, priced = rounding.to(step), rounding.to(step, price)
    assert repeated(priced) > repeated(plain) + 0.1
    errors = [mean_distance(target, basis.surface(step * grid), basis.fine) for grid in (plain, priced)]
    assert errors[1] < 1.3 * errors[0]
    moved = polished(basis, target, plain, step, price)
    assert repeated(moved) > repeated(plain)
    # No price makes neighbours meet: faces would vanish.
    for grid in (rounding.to(step, 1e4 * price), polished(basis, target, plain, step, 1e4 * price)):
        assert (grid[sharp[:, 0]] != grid[sharp[:, 1]]).any(axis=1).all()
