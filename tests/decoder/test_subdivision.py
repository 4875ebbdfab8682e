"""Loop's subdivision with sharp edges, its limit and its normals, against facts that are known otherwise."""

from __future__ import annotations

import manifolds
import numpy as np
import pytest

from cndhf_codec.decoder.surface.normals import limit_normals, sectors_of
from cndhf_codec.decoder.surface.subdivision import Topology, limit_positions, subdivide, topology_of

NONE = np.empty((0, 2), dtype=np.int64)
OCTAHEDRON = np.array([(4, 0, 1), (4, 1, 2), (4, 2, 3), (4, 3, 0), (5, 1, 0), (5, 2, 1), (5, 3, 2), (5, 0, 3)])
TIPS = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)


def levels(mesh: Topology, vertices: np.ndarray, n: int) -> tuple[Topology, np.ndarray]:
    for _ in range(n):
        weights, mesh = subdivide(mesh)
        vertices = weights.apply(vertices)
    return mesh, vertices


def some_sharp(faces: np.ndarray, share: float, seed: int = 0) -> np.ndarray:
    """A random share of the edges."""
    edges = topology_of(faces, faces.max() + 1, NONE).edges
    return edges[np.random.default_rng(seed).random(len(edges)) < share]


def random_mesh(name: str, share: float) -> tuple[Topology, np.ndarray]:
    faces = manifolds.KINDS[name]
    n = int(faces.max()) + 1
    return topology_of(faces, n, some_sharp(faces, share)), np.random.default_rng(1).normal(size=(n, 3))


KINDS = [k for k in manifolds.KINDS if len(manifolds.KINDS[k]) < 800]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("share", [0, 0.3, 1])
def test_weights_of_a_point_sum_to_one_and_edges_agree_with_those_found_anew(name, share):
    mesh, _ = random_mesh(name, share)
    for _ in range(2):
        for weights in (limit_positions(mesh), subdivide(mesh).vertices):
            np.testing.assert_allclose(np.bincount(weights.rows, weights.weights, weights.n_rows), 1, atol=1e-14)
            assert weights.weights.min() >= 0
        mesh = subdivide(mesh).topology
        again = topology_of(mesh.faces, mesh.n_vertices, mesh.edges[mesh.sharp])
        order = np.lexsort(mesh.edges.T[::-1])
        assert np.array_equal(mesh.edges[order], again.edges)
        assert np.array_equal(mesh.sharp[order], again.sharp)
        assert np.array_equal(mesh.edges[mesh.face_edges], again.edges[again.face_edges])


@pytest.mark.parametrize("name", ["torus", "sheet", "genus 2", "moebius strip", "parts"])
@pytest.mark.parametrize("share", [0, 0.1, 0.3, 1])
def test_the_limit_of_a_subdivided_mesh_is_that_of_the_mesh(name, share):
    mesh, vertices = random_mesh(name, share)
    if share == 0.1:
        assert (mesh.n_sharp == 1).any()  # darts
    limit = limit_positions(mesh).apply(vertices)
    for _ in range(3):
        mesh, vertices = levels(mesh, vertices, 1)
        np.testing.assert_allclose(limit_positions(mesh).apply(vertices)[: len(limit)], limit, atol=1e-12)


@pytest.mark.parametrize("n", [3, 4, 7, 60])
def test_darts_with_any_number_of_faces(n):
    mesh = topology_of(manifolds.fan(n), n + 1, [[0, 2]])
    vertices = np.random.default_rng(n).normal(size=(n + 1, 3))
    weights = limit_positions(mesh)
    finer, moved = levels(mesh, vertices, 1)
    np.testing.assert_allclose(limit_positions(finer).apply(moved)[0], weights.apply(vertices)[0], atol=1e-13)
    finer, moved = levels(mesh, vertices, 7)
    assert np.abs(moved[0] - weights.apply(vertices)[0]).max() < 0.1
    own = weights.rows == 0
    by_column = dict(zip(weights.columns[own].tolist(), weights.weights[own].tolist(), strict=True))
    for k in range(n):  # the weights are alike on both sides of the sharp edge
        assert by_column[1 + (1 + k) % n] == pytest.approx(by_column[1 + (1 - k) % n], abs=1e-15)


def test_a_regular_plane_stays_and_keeps_its_parameters():
    faces = manifolds.grid(9, 9)
    x, y = np.divmod(np.arange(100), 10)
    flat = np.column_stack([x, y, 0.5 * x - 0.25 * y]).astype(float)
    mesh = topology_of(faces, 100, NONE)
    finer, moved = levels(mesh, flat, 2)
    limit = limit_positions(finer).apply(moved)
    np.testing.assert_allclose(limit[:, 2], 0.5 * limit[:, 0] - 0.25 * limit[:, 1], atol=1e-13)
    inside = (x > 1) & (x < 8) & (y > 1) & (y < 8)
    np.testing.assert_allclose(limit[:100][inside], flat[inside], atol=1e-13)


@pytest.mark.parametrize("name", ["torus", "tetrahedron", "complete graph of 7", "sponge"])
def test_with_all_edges_sharp_it_is_the_polyhedron(name):
    mesh, vertices = random_mesh(name, 1)
    finer, moved = levels(mesh, vertices, 2)
    n = mesh.n_vertices
    limit = limit_positions(finer).apply(moved)
    np.testing.assert_array_equal(limit[:n], vertices)
    np.testing.assert_allclose(moved, limit, atol=1e-14)
    middles = vertices[mesh.edges].mean(axis=1)
    np.testing.assert_allclose(limit[n : n + len(middles)], middles, atol=1e-15)


def test_a_crease_stays_in_its_plane_and_follows_its_spline():
    faces = manifolds.grid(6, 6)
    x, y = np.divmod(np.arange(49), 7)
    vertices = np.column_stack([x, y, np.abs(x - 3.0) + 0.1 * np.sin(y)])
    along = np.flatnonzero(x == 3)
    mesh = topology_of(faces, 49, np.column_stack([along[:-1], along[1:]]))
    finer, moved = levels(mesh, vertices, 2)
    crease = np.unique(finer.edges[finer.sharp & (np.abs(moved[finer.edges, 0] - 3) < 1e-9).all(axis=1)])
    assert len(crease) == 25
    limit = limit_positions(finer).apply(moved)[along[1:-1]]
    np.testing.assert_allclose(limit[:, 0], 3, atol=1e-14)
    v = vertices[along]
    np.testing.assert_allclose(limit, (v[:-2] + 4 * v[1:-1] + v[2:]) / 6, atol=1e-14)


def test_an_octahedron_becomes_a_body_with_its_symmetries():
    mesh, vertices = levels(topology_of(OCTAHEDRON, 6, NONE), TIPS, 3)
    limit = limit_positions(mesh).apply(vertices)
    as_set = {tuple(p) for p in np.round(limit, 9) + 0.0}
    for image in (limit[:, [1, 2, 0]], limit * [-1, 1, 1], limit[:, [1, 0, 2]]):
        assert {tuple(p) for p in np.round(image, 9) + 0.0} == as_set
    radius = np.linalg.norm(limit, axis=1)
    assert radius.max() / radius.min() < 1.1


def test_valences_in_the_thousands_stay_finite():
    n = 4000
    faces = manifolds.sphere(n)
    angle = 2 * np.pi * np.arange(n) / n
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    vertices = np.concatenate([[(0, 0, 1)], rim, [(0, 0, -1)]])
    mesh = topology_of(faces, n + 2, NONE)
    limit = limit_positions(mesh).apply(vertices)
    assert 0 < limit[0, 2] < 1
    sectors = sectors_of(mesh)
    normals = limit_normals(mesh, vertices, limit, sectors)
    assert abs(normals[np.flatnonzero(sectors.vertices == 0)[0]] @ [0, 0, 1]) > 1 - 1e-9


def deep_normals(mesh: Topology, vertices: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """By corners of faces of the mesh: sums of triangle normals of the sector after many steps, each a difference."""
    finer, moved = levels(mesh, vertices, n)
    limit = limit_positions(finer).apply(moved)
    p = limit[finer.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    sectors = sectors_of(finer)
    out = np.zeros((len(sectors.vertices), 3))
    for k in range(3):
        np.add.at(out, sectors.corners[:, k], normal / np.linalg.norm(normal, axis=1, keepdims=True))
    return out / np.linalg.norm(out, axis=1, keepdims=True), sectors.vertices


@pytest.mark.parametrize("kind", ["smooth", "crease", "boundary"])
def test_normals_are_those_of_deep_subdivisions(kind):
    faces = manifolds.grid(6, 6) if kind != "smooth" else OCTAHEDRON
    if kind == "smooth":
        mesh, vertices = subdivide(topology_of(OCTAHEDRON, 6, NONE)).topology, None
        vertices = subdivide(topology_of(OCTAHEDRON, 6, NONE)).vertices.apply(TIPS)
        vertices = vertices * (1.0, 1.3, 0.7) + 0.05 * np.random.default_rng(0).normal(size=vertices.shape)
    else:
        x, y = np.divmod(np.arange(49), 7)
        z = 0.3 * np.sin(x) + 0.2 * np.cos(1.3 * y) + (np.abs(x - 3.0) if kind == "crease" else 0)
        vertices = np.column_stack([x, y, z])
        along = np.flatnonzero(x == 3)
        mesh = topology_of(faces, 49, np.column_stack([along[:-1], along[1:]]) if kind == "crease" else NONE)
    sectors = sectors_of(mesh)
    limit = limit_positions(mesh).apply(vertices)
    normals = limit_normals(mesh, vertices, limit, sectors)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    deep, at = deep_normals(mesh, vertices, 5)
    # Corners have other tangents; the ends of an inner crease are corners, too.
    for s in np.flatnonzero(mesh.n_sharp[sectors.vertices] <= 2):
        same = deep[at == sectors.vertices[s]]
        assert (same @ normals[s]).max() > 1 - 1e-4, (s, normals[s], same)


def test_sectors_are_what_lies_between_sharp_edges():
    mesh = topology_of(OCTAHEDRON, 6, [(0, 1), (1, 2), (2, 3), (0, 3)])
    sectors = sectors_of(mesh)
    assert sectors.vertices.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 5]
    assert sorted(sectors.sizes.tolist()) == [2] * 8 + [4] * 2
    assert np.array_equal(sectors.vertices[sectors.corners], mesh.faces)
    normals = limit_normals(mesh, TIPS, limit_positions(mesh).apply(TIPS), sectors)
    np.testing.assert_allclose(normals[8:], [(0, 0, 1), (0, 0, -1)], atol=1e-12)
    assert (np.sign(normals[:8, 2]).reshape(4, 2).sum(axis=1) == 0).all()


def test_faces_that_disagree_have_normals_of_their_own():
    faces = OCTAHEDRON.copy()
    faces[0] = faces[0, ::-1]
    mesh = topology_of(faces, 6, NONE)
    sectors = sectors_of(mesh)
    limit = limit_positions(mesh).apply(TIPS)
    normals = limit_normals(mesh, TIPS, limit, sectors)
    a, b, c = limit[faces[0]]
    alone = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
    np.testing.assert_allclose(normals[sectors.corners[0]], np.tile(alone, (3, 1)), atol=1e-12)
    # Vertex 0 keeps three of its faces on one side: (4, 3, 0) and two below, whose angles are alike.
    rest = sectors.corners[3, 2]
    assert sectors.sizes[rest] == 3
    p = limit[faces[[3, 4, 7]]]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    along = (flat / np.linalg.norm(flat, axis=1, keepdims=True)).sum(axis=0)
    np.testing.assert_allclose(normals[rest], along / np.linalg.norm(along), atol=1e-12)
    outward = (normals[sectors.corners[0]] * TIPS[faces[0]]).sum(axis=1)
    assert (outward < 0).all()
    assert ((normals[sectors.corners[1]] * TIPS[faces[1]]).sum(axis=1) > 0).all()


@pytest.mark.parametrize("sizes", [(1, 4), (2, 3), (2, 2), (4, 4)])
def test_normals_beside_a_crease_with_any_number_of_faces(sizes):
    n = sum(sizes)
    angle = 2 * np.pi * np.arange(n) / n
    rng = np.random.default_rng(2)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0.4 * rng.normal(size=n)])
    vertices = np.concatenate([[(0, 0, 0.3)], rim])
    mesh = topology_of(manifolds.fan(n), n + 1, [(0, 1), (0, 1 + sizes[0])])
    sectors = sectors_of(mesh)
    at_centre = np.flatnonzero(sectors.vertices == 0)
    assert sorted(sectors.sizes[at_centre]) == sorted(sizes)
    normals = limit_normals(mesh, vertices, limit_positions(mesh).apply(vertices), sectors)[at_centre]
    deep, at = deep_normals(mesh, vertices, 8)
    found = deep[at == 0] @ normals.T
    np.testing.assert_allclose(found.max(axis=0), 1, atol=5e-3)
    np.testing.assert_allclose(found.max(axis=1), 1, atol=5e-3)
