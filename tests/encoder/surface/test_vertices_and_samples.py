"""How many vertices and samples a surface of some bytes gets."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from types import SimpleNamespace
from typing import Any

import manifolds
import numpy as np
import pytest
import trimesh
from control_meshes import arrays

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.surface import encode, grid, to_size
from cndhf_codec.encoder.surface.encode import encode_surface
from cndhf_codec.encoder.surface.settings import FAST

pytestmark = pytest.mark.encode


def one(n_vertices: int, error: float) -> Any:
    return SimpleNamespace(control=np.zeros((n_vertices, 3)), error=error)


def trial(n_vertices: int, fit: float, error: float, step: float = 1e-3) -> Any:
    sized = SimpleNamespace(n_bytes=4000, error=error, mesh=SimpleNamespace(step=step))
    return SimpleNamespace(sized=sized, one=one(n_vertices, fit), mesh=None)


def no_stage(stage: str, total: int) -> Any:
    return lambda done, loss: None


def test_the_power_is_that_of_two_fits():
    assert to_size._power(one(100, 1.0), one(200, 0.25)) == pytest.approx((2, 2))
    assert to_size._power(one(200, 0.25), one(100, 1.0)) == pytest.approx((2, 2))
    assert to_size._power(one(100, 1.0), one(200, 0.9)) == (1, 1)
    assert to_size._power(one(100, 1.0), one(101, 0.0)) == (5, 5)
    assert to_size._power(one(100, 1.0), one(100, 1.0)) == (1, 1)


def test_vertices_are_fewer_where_rounding_is_most_of_the_error():
    powers = to_size.FIRST_POWERS
    assert to_size._balanced(trial(1000, 0.3, 0.35), powers, 0.05) == 1
    fewer = to_size._balanced(trial(1000, 0.1, 0.3), powers, 0.05)
    assert 0.6 < fewer < 0.95
    # The faster the fit gets worse with fewer vertices, the more are left.
    assert fewer < to_size._balanced(trial(1000, 0.1, 0.3), (3.0, 3.0), 0.05) <= 1
    # A step that is the finest already gains nothing by more bits.
    assert to_size._balanced(trial(1000, 0.1, 0.3, to_size.FINEST), powers, 0.05) == 1
    assert to_size._balanced(trial(1000, 0.0, 0.0), powers, 0.05) == 1
    assert to_size._balanced(trial(1000, 0.1, 0.3), powers, 0.9) == 1


@pytest.mark.parametrize("n_vertices", [100, 250, 1000, 4000])
def test_a_first_try_tells_how_many_vertices_fill_a_file(n_vertices):
    first: Any = SimpleNamespace(n_bytes=1000)
    assert 1 < to_size._times(first, n_vertices, 1200) < 1.25
    assert 0.05 < to_size._times(first, n_vertices, 200) < 1


def test_samples_follow_the_vertices_that_there_can_be(monkeypatch):
    counts = []
    target = encode.Target
    monkeypatch.setattr(encode, "Target", lambda v, f, n, seed: [counts.append(n), target(v, f, n, seed)][1])
    settings = replace(FAST, samples=500, rounds=1)
    cube, ball = trimesh.creation.box(), trimesh.creation.icosphere(4)
    encode_surface(*arrays(cube), replace(settings, target_size=1 << 20), 50, 0, no_stage, Deadline(inf))
    encode_surface(*arrays(ball), replace(settings, target_size=950), 50, 0, no_stage, Deadline(inf))
    assert counts == [500, 16 * 400]


def test_no_mesh_is_tried_twice(monkeypatch):
    tried = []
    fit_with_creases = to_size.fit_with_creases
    monkeypatch.setattr(
        to_size,
        "fit_with_creases",
        lambda mesh, *args: [tried.append(len(mesh.faces)), fit_with_creases(mesh, *args)][1],
    )
    settings = replace(FAST, samples=2000, rounds=1, least_foretold=0.0, other_counts=(0.999, 1.0, 1.001))
    for shape, size in ((trimesh.creation.icosphere(4), 600), (trimesh.creation.box(), 4000)):
        tried.clear()
        encode_surface(*arrays(shape), replace(settings, target_size=size), 50, 0, no_stage, Deadline(inf))
        assert len(set(tried)) == len(tried)


def test_progress_never_falls():
    done = []
    settings = replace(FAST, samples=2000, rounds=1, target_size=700, other_counts=(0.9, 1.1), tries=4, edits=1)
    # Flat and round: some tries have nearly all edges sharp, others few.
    shape = trimesh.creation.cylinder(1, 2, sections=64).subdivide()
    encode_surface(*arrays(shape), settings, 50, 0, lambda s, total: lambda k, loss: done.append(k), Deadline(inf))
    assert len(done) > 4
    assert done == sorted(done)


def test_a_file_that_can_hold_the_inputs_own_faces_does():
    rng = np.random.default_rng(0)
    rough = trimesh.creation.icosphere(3, 1.0)  # of 642 vertices, none of which the others foretell
    rough.vertices *= rng.uniform(0.9, 1.1, (len(rough.vertices), 1))
    settings = replace(FAST, samples=20_000, target_size=1600)
    made = encode_surface(*arrays(rough), settings, 50, 0, no_stage, Deadline(inf))
    assert len(made.mesh.positions) == 642
    assert len(made.mesh.sharp) == 1920
    assert made.error < 0.004  # a smooth surface has 0.017
    few = encode_surface(*arrays(rough), replace(settings, target_size=700), 50, 0, no_stage, Deadline(inf))
    assert len(few.mesh.positions) < 400


@pytest.mark.parametrize(("size", "nearly"), [(1500, True), (600, False)])
def test_nearly_all_faces_are_tried_where_coordinates_repeat(monkeypatch, size, nearly):
    # Steps of a few heights over a square lattice.
    n = 24
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    heights = 2 * np.random.default_rng(1).integers(0, 4, n * n)
    vertices = np.column_stack([x.ravel(), y.ravel(), heights]) / n - 0.5
    faces = manifolds.grid(n - 1, n - 1).astype(np.int64)
    counts = []

    def to(self: Any, n_faces: int) -> Any:
        counts.append(n_faces)
        return made(self, n_faces)

    made = to_size._Simplify.to
    monkeypatch.setattr(to_size._Simplify, "to", to)
    encode_surface(vertices, faces, replace(FAST, samples=5000, target_size=size), 50, 0, no_stage, Deadline(inf))
    assert (round(0.9 * len(faces)) in counts) == nearly


def test_coarser_steps_are_tried_where_edges_are_sharp():
    box = trimesh.creation.box((1.0, 0.777, 0.3)).subdivide()
    box.vertices += 0.1234
    vertices, faces = arrays(box)
    target = encode.Target(vertices, faces, 5000, 0)
    mesh = encode.cut(vertices, faces)
    simple = to_size.fit_simply(mesh, target, 2).best
    assert grid.smooth_share(simple) < 0.1
    none, some = (grid.on_grid(simple, mesh, target, 110, steps) for steps in (0, 12))
    assert some.mesh.step > none.mesh.step
    assert some.error < 0.9 * none.error
    assert some.n_bytes <= 110
    ball = encode.cut(*arrays(trimesh.creation.icosphere(2)))
    round_one = to_size.fit_simply(ball, encode.Target(ball.vertices, ball.faces, 5000, 0), 2).best._replace(
        sharp=np.zeros((0, 2), dtype=np.int64)
    )
    smooth = [grid.on_grid(round_one, ball, target, 300, steps) for steps in (0, 12)]
    assert smooth[0].mesh.step == smooth[1].mesh.step


def simple_lattice() -> tuple[Any, Any, Any]:
    """A polyhedron whose coordinates repeat, its control mesh and a target."""
    box = trimesh.creation.box((1.0, 0.777, 0.3)).subdivide().subdivide()
    box.vertices += 0.1234
    vertices, faces = arrays(box)
    target = encode.Target(vertices, faces, 5000, 0)
    mesh = encode.cut(vertices, faces)
    return to_size.fit_simply(mesh, target, 2).best, mesh, target


def test_no_step_is_coded_twice(monkeypatch):
    """Where coordinates repeat, the bytes do not fall evenly with the step: the search must not go to and fro."""
    simple, mesh, target = simple_lattice()
    steps: list[float] = []

    def coded(self: Any, step: float, positions: Any) -> Any:
        steps.append(step)
        made = code(self, step, positions)
        # All that is finer is too large, and all else leaves a twentieth.
        return made._replace(n_bytes=210 if step < 0.0123 else 190)

    code = grid._Grids._coded
    monkeypatch.setattr(grid._Grids, "_coded", coded)
    grids = grid._Grids(simple, mesh, target, 200)
    for start in (0.0121, 0.0122, 0.0124, 0.01):
        steps.clear()
        made = grids.filled(start, 0.0)
        assert made.n_bytes == 190
        assert len(steps) == len(set(steps)) < grid.STEP_TRIES


def test_what_has_no_hope_is_left_as_it_is_rounded(monkeypatch):
    simple, mesh, target = simple_lattice()
    polished: list[float] = []
    polish = grid.polished
    monkeypatch.setattr(grid, "polished", lambda *given: [polished.append(given[3]), polish(*given)][1])
    best = grid.on_grid(simple, mesh, target, 110, 6)
    assert polished
    polished.clear()
    same = grid.on_grid(simple, mesh, target, 110, 6, best.error)
    assert np.array_equal(same.mesh.positions, best.mesh.positions)
    assert same.mesh.step == best.mesh.step
    assert polished
    polished.clear()
    assert grid.on_grid(simple, mesh, target, 110, 6, best.error / 10).error >= best.error
    assert not polished


def test_fast_makes_two_tries(monkeypatch):
    fits = []
    fit_with_creases = to_size.fit_with_creases
    monkeypatch.setattr(to_size, "fit_with_creases", lambda *given: [fits.append(1), fit_with_creases(*given)][1])
    given = arrays(trimesh.creation.icosphere(3, 1.0))
    for tries in (1, 2):
        fits.clear()
        settings = replace(FAST, samples=3000, target_size=900, other_counts=(0.9, 1.1), tries=tries)
        encode_surface(*given, settings, 50, 0, no_stage, Deadline(inf))
        assert len(fits) == tries
    assert FAST.tries == 2
