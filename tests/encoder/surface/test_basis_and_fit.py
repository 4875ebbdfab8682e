"""The basis against the decoder's subdivision, the normal equations against dense ones, and fits that go home."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from control_meshes import NO_EDGES, arrays, mean_distance, square, target_of

from cndhf_codec.decoder.surface.levels import Level, next_level
from cndhf_codec.decoder.surface.subdivision import topology_of
from cndhf_codec.encoder.surface import fit as fit_module
from cndhf_codec.encoder.surface.basis import Basis, basis_of, coarsest_basis, levels_of
from cndhf_codec.encoder.surface.fit import fit, linearised, mean_errors, solved


def cases() -> dict[str, tuple[trimesh.Trimesh, np.ndarray]]:
    cube = trimesh.creation.box()
    return {
        "ball": (trimesh.creation.icosphere(1), NO_EDGES),
        "cube with sharp edges": (cube, np.array([(min(a, b), max(a, b)) for a, b in cube.edges_unique])),
        "open": (square(3), NO_EDGES),
        "ball with a crease that ends": (trimesh.creation.icosphere(1), np.array([(0, 12)])),
        "triangle": (trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], process=False), NO_EDGES),
    }


@pytest.fixture(params=list(cases()))
def case(request) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(vertices, faces, sharp edges)."""
    mesh, sharp = cases()[request.param]
    return *arrays(mesh), sharp


@pytest.mark.parametrize("levels", [0, 1, 3])
def test_the_surface_is_the_decoders(case, levels):
    vertices, faces, sharp = case
    basis = basis_of(faces, len(vertices), sharp, levels)
    level = Level(0, topology_of(faces, len(vertices), sharp), vertices)
    for _ in range(levels):
        level = next_level(level)
    surface, topology = basis.surface(vertices), level.topology
    np.testing.assert_allclose(surface, next_level(level).limit, atol=1e-12)
    np.testing.assert_allclose(surface[: topology.n_vertices], level.limit, atol=1e-12)
    np.testing.assert_array_equal(basis.fine, topology.faces)
    np.testing.assert_array_equal(basis.nodes, np.column_stack([basis.fine, len(level.limit) + topology.face_edges]))


def test_levels_follow_from_the_faces_and_those_that_are_bent():
    fine = trimesh.creation.box()
    for _ in range(5):
        fine = fine.subdivide()
    vertices, faces = arrays(fine)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert len(faces) == 12288
    some, half = edges[20:], edges[: len(edges) // 2]
    levels = {
        name: coarsest_basis(faces, len(vertices), sharp).levels
        for name, sharp in (("all", edges), ("none", NO_EDGES), ("nearly all", some), ("half", half))
    }
    assert levels == {"all": 0, "none": 2, "nearly all": 1, "half": 2}
    assert coarsest_basis(faces, len(vertices), some, 2).levels == 2
    # Where there are few faces, bent ones need their levels.
    vertices, faces = arrays(trimesh.creation.icosphere(2))
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert coarsest_basis(faces, len(vertices), edges[2:]).levels == levels_of(len(faces)) == 3


def test_points_of_patches_lie_on_the_limit_surface():
    vertices, faces = arrays(trimesh.creation.icosphere(1))
    basis = basis_of(faces, len(vertices), NO_EDGES, 2)
    level = Level(0, topology_of(faces, len(vertices), NO_EDGES), vertices)
    for _ in range(5):
        level = next_level(level)
    exact = target_of(trimesh.Trimesh(level.limit, level.topology.faces, process=False), 10)
    surface, chosen = basis.surface(vertices), np.arange(len(basis.nodes))
    places = np.tile([0.5, 0.3, 0.2], (len(chosen), 1))
    shapes, points = fit_module._points_at(surface, basis.nodes, chosen, places)
    np.testing.assert_allclose(shapes.sum(axis=1), 1)
    flat = np.einsum("kn,knx->kx", places, surface[basis.fine])
    assert exact.closest(points).distances.max() < 0.1 * exact.closest(flat).distances.max()


def near_a_flat_patch(nearest: list[float], sample: list[float]) -> np.ndarray:
    """The point near a sample, of the triangle (0, 0), (1, 0), (0, 1) at height 0."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    surface = np.concatenate([corners, (corners + corners[[1, 2, 0]]) / 2])
    nodes, first = np.arange(6)[None], np.zeros(1, dtype=np.int64)
    shapes, points = fit_module._points_near(surface, nodes, first, np.array([nearest]), np.array([sample]))
    np.testing.assert_allclose(shapes @ surface, points, atol=1e-12)
    assert shapes.sum() == pytest.approx(1)
    return points[0]


def test_a_step_towards_samples_is_exact_in_flat_patches():
    np.testing.assert_allclose(near_a_flat_patch([0.3, 0.3, 0], [0.3, 0.2, 0.7]), [0.3, 0.2, 0], atol=1e-12)
    x, y, z = near_a_flat_patch([0.3, 0.3, 0], [-1.0, 0.5, 0])
    assert min(x, y) >= 0
    assert x + y <= 1
    assert z == 0


def test_gaps_off_the_normal_are_distances():
    normals = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1]])
    offsets = np.array([[0.1, 0, -1], [3, 0, 4], [4, 0, 3]])
    gaps, distances = fit_module._gaps(normals, offsets)
    np.testing.assert_allclose(gaps, [-1, 4, 5])
    np.testing.assert_allclose(distances, [np.sqrt(1.01), 5, 5])
    np.testing.assert_allclose(normals, [[0, 0, 1], [0, 0, 1], [0.8, 0, 0.6]])


def test_rows_sum_to_one_and_owners_cover_their_faces(case):
    vertices, faces, sharp = case
    basis = basis_of(faces, len(vertices), sharp, 2)
    np.testing.assert_allclose(basis.matrix.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(np.bincount(basis.owner), np.full(len(faces), 16))
    assert basis.n_faces == len(faces)


def test_the_support_has_every_vertex_that_a_face_depends_on(case):
    vertices, faces, sharp = case
    basis = basis_of(faces, len(vertices), sharp, 2)
    dense = basis.matrix.toarray()
    for f in range(len(faces)):
        support = basis.support[basis.ptr[f] : basis.ptr[f + 1]]
        rows = dense[np.unique(basis.nodes[basis.owner == f])]
        np.testing.assert_array_equal(support, np.flatnonzero(np.abs(rows).max(axis=0)))


def dense_normal(basis: Basis, target, control) -> tuple[np.ndarray, np.ndarray]:
    """J^T W J and J^T W gaps, with a row of J for each pair."""
    pairs = fit_module._paired(basis, target, control, even=False)
    weights = np.zeros((len(pairs.faces), basis.n_vertices))
    dense = basis.matrix.toarray()
    for c in range(6):
        weights += pairs.shapes[:, [c]] * dense[basis.nodes[pairs.faces, c]]
    rows = (weights[:, :, None] * pairs.normals[:, None, :]).reshape(len(weights), -1)
    return rows.T @ (rows * pairs.weights[:, None]), rows.T @ (pairs.weights * pairs.gaps)


def test_the_normal_equations_are_those_of_a_dense_least_squares(case):
    vertices, faces, sharp = case
    target = target_of(trimesh.creation.icosphere(2, 0.8), 500)
    basis = basis_of(faces, len(vertices), sharp, 1)
    normal = linearised(basis, target, vertices)
    matrix, side = dense_normal(basis, target, vertices)
    np.testing.assert_allclose(normal.matrix.toarray(), matrix, atol=1e-10 * np.abs(matrix).max())
    np.testing.assert_allclose(normal.side, side, atol=1e-10 * np.abs(side).max())
    assert normal.mean == pytest.approx(mean_errors(basis, target, vertices).sum())


def test_conjugate_gradients_solve():
    mesh = arrays(trimesh.creation.icosphere(1))
    basis = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, 1)
    normal = linearised(basis, target_of(trimesh.creation.icosphere(3, 0.9), 2000), mesh.vertices)
    damping = 0.1 * normal.matrix.diagonal().mean()
    dense = normal.matrix.toarray() + damping * np.eye(len(normal.side))
    expected = np.linalg.solve(dense, normal.side)
    np.testing.assert_allclose(
        solved(normal.matrix, normal.side, damping), expected, atol=1e-2 * np.abs(expected).max()
    )


def test_the_mean_is_the_distance_that_is_measured():
    mesh = arrays(trimesh.creation.icosphere(1))
    target = target_of(trimesh.creation.icosphere(4))
    basis = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, 3)
    surface = basis.surface(mesh.vertices)
    assert mean_errors(basis, target, mesh.vertices).sum() == pytest.approx(
        mean_distance(target, surface, basis.fine), rel=0.02
    )


def test_a_disturbed_control_mesh_goes_back_to_the_sphere():
    ball = trimesh.creation.icosphere(4)
    target = target_of(ball)
    mesh = arrays(trimesh.creation.icosphere(1))
    disturbed = mesh.vertices + np.random.default_rng(0).normal(size=mesh.vertices.shape) * 0.1
    kept = disturbed.copy()
    basis = basis_of(mesh.faces, len(disturbed), NO_EDGES, 3)
    before = mean_errors(basis, target, disturbed).sum()
    after = [mean_errors(basis, target, fit(basis, target, disturbed, rounds)).sum() for rounds in (1, 8)]
    assert after[0] < before / 2
    assert after[1] < before / 30
    np.testing.assert_array_equal(disturbed, kept)


def test_an_open_sheet_keeps_its_boundary():
    wavy = square(40)
    wavy.vertices[:, 2] = 0.1 * np.sin(6 * wavy.vertices[:, 0]) * wavy.vertices[:, 1]
    target = target_of(wavy)
    flat = arrays(square(4))
    start = 0.02 + 0.96 * flat.vertices  # the rim has to find its way out
    basis = basis_of(flat.faces, len(start), NO_EDGES, 3)
    control = fit(basis, target, start, 12)
    surface = basis.surface(control)
    assert mean_errors(basis, target, control).sum() < mean_errors(basis, target, start).sum() / 10
    np.testing.assert_allclose([surface.min(axis=0), surface.max(axis=0)], wavy.bounds, atol=0.02)


def test_equal_sums_whatever_the_threads():
    import numba

    target = target_of(trimesh.creation.icosphere(3))
    mesh = arrays(trimesh.creation.icosphere(1, 0.9))
    basis = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, 2)
    most = numba.get_num_threads()
    results = []
    try:
        for n in (1, most, 1):
            numba.set_num_threads(n)
            results.append(fit(basis, target, mesh.vertices, 3).tobytes())
    finally:
        numba.set_num_threads(most)
    assert results[0] == results[1] == results[2]
