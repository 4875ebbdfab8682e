"""What holds for a `Model` of either representation; and what only surfaces do."""

from __future__ import annotations

import pickle
import threading
from dataclasses import replace

import analytic
import manifolds
import numpy as np
import pytest
import surfaces
from analytic import ABOUT_Z_45, slab
from places import ROOT

from cndhf_codec import Limits, load, loads
from cndhf_codec.decoder import Model
from cndhf_codec.decoder.queries import TriangleQueries
from cndhf_codec.decoder.surface import representation
from cndhf_codec.decoder.surface.levels import Level, distances_from_limit, next_level
from cndhf_codec.decoder.surface.subdivision import topology_of
from cndhf_codec.errors import OptionError, SectionError, SheetError, SurfaceError
from cndhf_codec.format import Metadata
from cndhf_codec.mesh.distances import surface_distances

CENTRE, SCALE = (10.0, -20.0, 30.0), 4.0
CUBES = {
    "dhf": lambda **where: analytic.model(slab((-0.5,) * 3, (0.5,) * 3), **where),
    "surface": surfaces.cube,
}


@pytest.fixture(params=CUBES)
def kind(request):
    return request.param


@pytest.fixture
def cube(kind):
    """The cube of side 4 around (10, -20, 30), as a file holds it."""
    return loads(CUBES[kind](centre=CENTRE, scale=SCALE).dumps())


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-1, 1, (3000, 3)) * 3 + CENTRE


def box_distance(points):
    q = np.abs(points - CENTRE) - SCALE / 2
    return -(np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0))


def test_it_says_what_it_is(cube, kind):
    assert cube.representation == cube.info["representation"] == kind
    assert ("dhfs" in cube.info) == (kind == "dhf")
    assert sum(cube.info["sections"].values()) == cube.info["bytes"] == len(cube.dumps())


def test_in_and_out(cube, points):
    expected = box_distance(points)
    sure = np.abs(expected) > 1e-5
    assert np.array_equal(cube.contains(points)[sure], expected[sure] > 0)
    assert np.array_equal((cube.implicit(points) > 0)[sure], expected[sure] > 0)
    assert not cube.contains([[np.nan, 0, 0], [np.inf, 0, 0]]).any()


def test_distances_have_the_sign_of_the_side(cube, kind, points):
    expected = box_distance(points)
    found = cube.distance(points)
    # Marching cubes cuts the edges of the cube by less than a cell.
    np.testing.assert_allclose(found, expected, atol=1e-12 if kind == "surface" else SCALE / 256)
    near = cube.nearest(points)
    np.testing.assert_allclose(near.distance, np.abs(found), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(near.point - points, axis=1), near.distance, atol=1e-9)


def test_gradients_and_normals_point_outward(cube):
    on_faces = np.array([(2, 0.3, 0.1), (0.2, -2, 0.4), (0.1, 0.3, 2)]) + CENTRE
    outward = [(1, 0, 0), (0, -1, 0), (0, 0, 1)]
    np.testing.assert_allclose(cube.normals(on_faces), outward, atol=1e-5)
    for inwards in (0, 0.05, -0.05):
        f, g = cube.implicit(on_faces - inwards * np.array(outward), gradient=True)
        np.testing.assert_allclose(f, inwards, atol=1e-5)
        np.testing.assert_allclose(g, -np.array(outward), atol=1e-5)


def test_only_queries_that_need_normals_make_them(points, monkeypatch):
    made, shaded = [], representation._Chosen.shaded
    monkeypatch.setattr(representation._Chosen, "shaded", lambda chosen: [made.append(1), shaded(chosen)][1])
    cube = surfaces.cube()
    cube.contains(points)
    cube.distance(points)
    cube.implicit([[0, 0, 0], [1e3, 0, 0]], gradient=True)
    cube.normals([[np.nan, 0, 0]])
    assert not made
    cube.normals(points)
    cube.normals(points)
    assert made == [1]


def test_rays(cube):
    hits = cube.ray_intersect([[0, -20, 30.5], CENTRE, [0, 0, 0]], [[5, 0, 0], [0, 0, 1], [0, 1, 0]])
    np.testing.assert_allclose(hits.distance, [8, 2, np.inf], atol=1e-4)
    np.testing.assert_allclose(hits.point[:2], [(8, -20, 30.5), (10, -20, 32)], atol=1e-4)
    np.testing.assert_allclose(hits.normal[:2], [(-1, 0, 0), (0, 0, 1)], atol=1e-5)
    assert np.isnan(hits.point[2]).all()
    single = cube.ray_intersect(np.float32([0, -20, 30]), np.float32([1, 0, 0]))
    assert single.distance.dtype == np.float32
    assert single.distance.shape == ()


def test_shapes_of_points_are_kept_and_pieces_do_not_matter(cube, kind, points, monkeypatch):
    whole = {name: getattr(cube, name)(points) for name in ("contains", "implicit", "distance", "normals")}
    monkeypatch.setattr(type(cube._shape), "points_at_once", 100)
    for name, expected in whole.items():
        shaped = getattr(cube, name)(points.reshape(3, 1000, 3))
        assert shaped.shape == (3, 1000, *expected.shape[1:])
        np.testing.assert_allclose(shaped.reshape(expected.shape), expected, atol=1e-5)
        assert getattr(cube, name)(np.empty((0, 3))).shape == (0, *expected.shape[1:])
        with pytest.raises(OptionError, match=r"\(\.\.\., 3\)"):
            getattr(cube, name)(np.zeros((4, 2)))


def test_meshes_are_watertight_and_lie_on_the_surface(cube):
    mesh = cube.to_mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(SCALE**3, rel=1e-4)
    assert np.abs(box_distance(mesh.vertices)).max() < SCALE / 256
    vertices, faces = cube.surface()
    np.testing.assert_array_equal(faces, mesh.faces)
    np.testing.assert_allclose(vertices * SCALE + CENTRE, mesh.vertices, atol=1e-12)


def test_grids(cube):
    grid, origin, spacing = cube.occupancy(16)
    inner = box_distance(origin + spacing * np.argwhere(grid))
    outer = box_distance(origin + spacing * np.argwhere(~grid))
    assert inner.min() > 0 > outer.max()
    assert not grid[[0, -1]].any()
    with pytest.raises(OptionError, match="8 to 2048"):
        cube.occupancy(4)
    cube.limits = Limits(nodes=1000)
    with pytest.raises(SurfaceError, match="nodes"):
        cube.occupancy(64)


def test_gradients_are_those_of_the_function(cube, points):
    f, gradient = cube.implicit(points, gradient=True)
    np.testing.assert_array_equal(f, cube.implicit(points))
    for k in range(3):
        step = 4e-3 * np.eye(3)[k]
        ahead, behind = (cube.implicit(points + step) - f) / 4e-3, (f - cube.implicit(points - step)) / 4e-3
        smooth = np.abs(ahead - behind) < 0.01
        assert smooth.mean() > 0.8
        np.testing.assert_allclose(gradient[smooth, k], (ahead + behind)[smooth] / 2, atol=0.02)


def test_far_from_the_origin(kind, cube, points):
    far = np.array((1e6, -2e6, 3e6))
    there = CUBES[kind](centre=tuple(CENTRE + far), scale=SCALE)
    moved = points + far
    sure = np.abs(box_distance(points)) > 1e-5
    assert np.array_equal(there.contains(moved)[sure], cube.contains(points)[sure])
    np.testing.assert_allclose(there.distance(moved), cube.distance(points), atol=1e-8)
    np.testing.assert_allclose(there.nearest(moved).point - far, cube.nearest(points).point, atol=1e-8)
    hits = there.ray_intersect(far + CENTRE + [0.1, 0.2, 100], [0.0, 0, -1])
    assert hits.distance == pytest.approx(98, abs=1e-4)


def test_points_that_are_not_finite(cube):
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]
    distance = cube.distance(bad)
    assert np.isnan(distance[0])
    assert (distance[1:] == -np.inf).all()
    near = cube.nearest(bad)
    assert np.isnan(near.point).all()
    assert np.isinf(near.distance[1:]).all()
    with np.errstate(invalid="ignore"):
        assert not (cube.implicit(bad) >= 0).any()
        cube.implicit(bad, gradient=True)
        cube.normals(bad)
    none = cube.ray_intersect([[0, 0, 0], bad[0], bad[1]], [[0, 0, 0], [1, 0, 0], [1, 0, 0]])
    assert np.isinf(none.distance).all()
    assert np.isnan(none.normal).all()


def test_a_turned_frame(kind, points):
    """Both read their quaternion in the same way."""
    made = CUBES[kind](centre=CENTRE, scale=SCALE)
    if kind == "dhf":
        turned = analytic.model(slab((-0.5,) * 3, (0.5,) * 3, ABOUT_Z_45), centre=CENTRE, scale=SCALE)
    else:
        mesh = replace(made.container.surface, quaternion=ABOUT_Z_45)
        turned = Model(replace(made.container, surface=mesh))
    r = np.sqrt(0.5)
    there = (points - CENTRE) @ np.array([[r, r, 0], [-r, r, 0], [0, 0, 1]]) + CENTRE
    sure = np.abs(box_distance(there)) > 1e-3
    assert np.array_equal(turned.contains(points)[sure], made.contains(there)[sure])


def test_many_threads_at_once(cube, points):
    expected = cube.distance(points), cube.contains(points), cube.ray_intersect(points, CENTRE - points).distance
    fresh = Model(cube.container)
    found = {}

    def ask(k):
        found[k] = fresh.distance(points), fresh.contains(points), fresh.ray_intersect(points, CENTRE - points).distance

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    for answers in found.values():
        for a, b in zip(answers, expected, strict=True):
            np.testing.assert_array_equal(a, b)


def test_any_number_of_triangles_below_a_level():
    ball = surfaces.ball(scale=10.0)
    fine = ball.to_mesh(level=6)
    errors = []
    for faces in (20, 100, 1000):
        mesh = ball.to_mesh(faces=faces)
        assert len(mesh.faces) == faces
        assert mesh.is_watertight
        errors.append(surface_distances(fine.vertices, fine.faces, mesh.vertices, mesh.faces, samples=5000).mean)
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    # Better than the level with fewer, by what the number gives.
    level = ball.to_mesh(level=2)
    level_error = surface_distances(fine.vertices, fine.faces, level.vertices, level.faces, samples=5000).mean
    assert errors[1] < 1.3 * level_error * 128 / 100


def test_a_simplified_mesh_keeps_the_surfaces_normals_and_its_creases():
    cylinder = surfaces.capped_tube()
    mesh = cylinder.to_mesh(faces=60, normals=True)
    assert len(mesh.faces) == 60
    across = np.abs(mesh.vertex_normals[:, 2])
    # Each normal is a cap's or the wall's, none between the two.
    assert ((across < 0.1) | (across > 0.99)).all()
    assert (across < 0.1).any()
    assert (across > 0.99).any()
    of_faces = np.einsum("fkx,fx->fk", mesh.vertex_normals[mesh.faces], mesh.face_normals)
    assert of_faces.min() > 0.7


def test_a_simplified_sheet_keeps_its_rim():
    sheet = surfaces.sheet()
    level, mesh = sheet.to_mesh(level=1), sheet.to_mesh(faces=120)
    assert len(mesh.faces) == 120
    rims = []
    for m in (level, mesh):
        single = m.edges_unique[np.bincount(m.edges_unique_inverse) == 1]
        rims.append({tuple(p) for p in np.round(m.vertices[np.unique(single)], 9).tolist()})
    assert len(rims[0]) == 48
    assert rims[0] == rims[1]


def test_copies_answer_alike(cube, points):
    twin = pickle.loads(pickle.dumps(cube))
    assert np.array_equal(twin.contains(points), cube.contains(points))


def test_options_of_the_other_kind_are_refused():
    with pytest.raises(OptionError, match="level belongs to surfaces"):
        CUBES["dhf"]().to_mesh(level=1)
    for options in ({"resolution": 64}, {"method": "intersection"}):
        with pytest.raises(OptionError, match="belong to double height fields"):
            surfaces.cube().to_mesh(**options)
    with pytest.raises(OptionError, match="belong to double height fields"):
        surfaces.cube().surface(64)
    with pytest.raises(OptionError, match="level belongs"):
        CUBES["dhf"]().surface(level=1)
    with pytest.raises(OptionError, match="prefix belongs to double height fields"):
        surfaces.cube().prefix(1)
    with pytest.raises(OptionError, match="heights belongs to double height fields"):
        surfaces.cube().heights(0, [0, 0])
    from cndhf_codec import loads_prefix

    with pytest.raises(SectionError, match="only be read as a whole"):
        loads_prefix(surfaces.cube().dumps())


def test_info_of_surfaces():
    info = surfaces.shell().info
    wanted = {"vertices": 16, "faces": 24, "sharp_edges": 36, "components": 2, "closed": True}
    assert {key: info[key] for key in wanted} == wanted
    assert not surfaces.sheet().info["closed"]
    many = manifolds.KINDS["triangles"]
    assert Model(surfaces.container(many, np.random.default_rng(0).random((300, 3)))).info["components"] == 100


def test_a_cavity_is_outside():
    shell = surfaces.shell()
    assert shell.contains([[0, 0, 0], [0.3, 0.3, 0.3], [0.6, 0, 0]]).tolist() == [False, True, False]
    np.testing.assert_allclose(shell.distance([[0, 0, 0], [0.35, 0, 0]]), [-0.25, 0.1], atol=1e-12)
    assert shell.to_mesh().volume == pytest.approx(7 / 8)


def test_parts_that_overlap_are_united():
    faces = manifolds.together(surfaces.CUBE, surfaces.CUBE)
    moved = surfaces.CORNERS + np.array((0.5, 0.25, 0.25))
    corners = np.concatenate([surfaces.CORNERS, moved])
    two = Model(surfaces.container(faces, corners, surfaces.edges_of(faces)))
    assert two.contains([[0.75, 0.5, 0.5], [1.25, 0.5, 0.5], [1.25, 0.1, 0.5]]).tolist() == [True, True, False]


def test_a_polyhedron_needs_no_subdivision():
    assert len(surfaces.cube().to_mesh().faces) == 12
    assert len(surfaces.cube().to_mesh(max_error="0.00001%").faces) == 12


@pytest.mark.parametrize("make", [surfaces.ball, surfaces.sheet])
def test_the_level_follows_from_the_error(make):
    model = make()
    exact = model.surface(level=6).vertices
    diagonal = np.linalg.norm(np.ptp(exact, axis=0))
    counts = []
    for percent in (3, 0.3, 0.03):
        mesh = model.to_mesh(max_error=f"{percent}%")
        counts.append(len(mesh.faces))
        off = TriangleQueries(mesh.vertices, mesh.faces).nearest(exact).distance.max() / diagonal
        assert off <= 1.1 * percent / 100
        assert 16 * off > percent / 100 or len(mesh.faces) == model.info["faces"]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_the_estimate_of_the_error_is_about_the_distance():
    control = surfaces.ball().container.surface
    level = Level(0, topology_of(control.faces, 6, control.sharp), control.vertices)
    exact = surfaces.ball().surface(level=6).vertices
    for allowed in (0.3, 0.1, 0.1, 0.1):
        off = TriangleQueries(level.limit, level.topology.faces).nearest(exact).distance.max()
        assert distances_from_limit(level).greatest == pytest.approx(off, rel=allowed)
        level = next_level(level)


def test_numbers_of_triangles_and_levels():
    ball = surfaces.ball()
    assert [len(ball.to_mesh(level=k).faces) for k in range(4)] == [8, 32, 128, 512]
    assert [len(ball.to_mesh(faces=n).faces) for n in (8, 31, 32, 127, 10**9)] == [8, 30, 32, 126, 8 * 4**6]
    with pytest.raises(OptionError, match="4 or more"):
        ball.to_mesh(faces=3)
    with pytest.raises(OptionError, match="0 to 6"):
        ball.to_mesh(level=7)
    with pytest.raises(OptionError, match="one of level, max_error and faces"):
        ball.to_mesh(level=1, faces=100)
    with pytest.raises(SurfaceError, match="raise max_error"):
        ball.to_mesh(max_error=1e-12)
    ball.limits = Limits(vertices=100)
    with pytest.raises(SurfaceError, match="level 3 has 258 vertices; 100 are allowed"):
        ball.to_mesh(level=3)
    with pytest.raises(SurfaceError, match="level 2, the finest one that is allowed"):
        ball.to_mesh(max_error="0.001%")


def measured(model, mean):
    """The same file, whose metadata states this mean error."""
    return Model(replace(model.container, metadata=Metadata(mean_error=mean, p99_error=4 * mean, max_error=9 * mean)))


@pytest.mark.parametrize("make", [surfaces.ball, surfaces.sheet, surfaces.capped_tube])
def test_a_default_mesh_is_as_fine_as_the_files_error_asks_for(make):
    model = make()
    exact = model.surface(level=6).vertices
    counts = []
    for mean in (2e-2, 2e-3, 2e-4):
        vertices, faces = measured(model, mean).surface()
        counts.append(len(faces))
        off = TriangleQueries(vertices, faces).nearest(exact).distance
        assert off.mean() < mean / 4
        assert np.quantile(off, 0.9) < mean / 2
        # A level less would be off by about four times as much.
        assert off.max() > mean / 12
    assert 2 * counts[0] < counts[1] < counts[2] / 2


def test_a_file_that_states_no_error_has_a_mesh_within_a_share_of_the_diagonal():
    ball = surfaces.ball()
    diagonal = np.linalg.norm(np.ptp(ball.surface(level=0).vertices, axis=0))
    wanted = measured(ball, 4e-4 * diagonal).surface()
    for same in (ball, measured(ball, 0.0)):
        np.testing.assert_array_equal(same.surface().faces, wanted.faces)


def test_whatever_a_file_states_of_its_error_the_mesh_keeps_its_shape():
    ball = surfaces.ball()
    wild, most = (measured(ball, mean).surface() for mean in (1e30, 0.02 * np.sqrt(12)))
    assert len(wild.faces) >= len(most.faces) > 8


def test_triangles_of_several_levels_have_no_gaps():
    # A long tip on a ball: there the surface bends most.
    tips = surfaces.TIPS * [1, 1, 3]
    model = Model(surfaces.container(surfaces.OCTAHEDRON, tips))
    mesh = measured(model, 2e-3).to_mesh()
    areas = mesh.area_faces
    assert areas.max() > 10 * areas.min()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    whole = model.to_mesh(level=6)
    assert mesh.volume == pytest.approx(whole.volume, rel=2e-3)
    assert len(mesh.faces) < len(model.to_mesh(max_error=2e-3).faces)
    shaded = measured(model, 2e-3).to_mesh(normals=True)
    np.testing.assert_array_equal(shaded.faces, mesh.faces)
    np.testing.assert_array_equal(shaded.vertices, mesh.vertices)
    assert (shaded.vertex_normals[shaded.faces].mean(axis=1) * mesh.face_normals).sum(axis=1).min() > 0.9


@pytest.mark.parametrize("mean", [0.02, 0.005])
def test_what_is_finer_asks_for_what_it_lies_in(mean):
    # Among random vertices, edges of a level may keep to what those of the next do not.
    faces = manifolds.voxels(np.random.default_rng(0).random((3, 3, 3)) < 2)
    model = Model(surfaces.container(faces, np.random.default_rng(1).random((1 + faces.max(), 3)) - 0.5))
    mesh = measured(model, mean).to_mesh()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert not {len(faces) * 4**k for k in range(7)} & {len(mesh.faces)}


def test_a_default_mesh_is_as_much_outside_as_inside():
    ball = surfaces.ball()
    exact = ball.to_mesh(level=6).volume
    mesh = measured(ball, 5e-3).to_mesh()
    level = ball.to_mesh(level=3)
    assert level.volume < 0.99 * exact  # all of its vertices are on a surface that bends one way
    assert mesh.volume == pytest.approx(exact, rel=1e-3)


def test_what_is_sharp_stays_where_it_is():
    tube = surfaces.capped_tube()
    mesh = measured(tube, 1e-3).to_mesh(normals=True)
    ends = np.abs(mesh.vertices[:, 2]) > 0.499
    np.testing.assert_allclose(np.abs(mesh.vertices[ends, 2]), 0.5, atol=1e-12)
    rims = {tuple(p) for p in np.round(tube.surface(level=6).vertices, 9).tolist()}
    across = np.abs(mesh.vertex_normals[:, 2]) < 0.1
    assert {tuple(p) for p in np.round(mesh.vertices[ends & across], 9).tolist()} <= rims


def test_where_faces_disagree_in_orientation_the_vertices_stay_on_the_limit():
    model = load(ROOT / "spec" / "vectors" / "surface-moebius.cndhf")
    finest = TriangleQueries(*model.surface(level=5))
    assert finest.nearest(model.surface().vertices).distance.max() < 1e-12


def test_a_single_bump_does_not_divide_everything():
    # A plane with a tip in its middle: only there the triangles are far off.
    faces = manifolds.grid(40, 40)
    x, y = (n / 40 for n in np.divmod(np.arange(41 * 41), 41))
    z = 0.01 * (np.hypot(x - 0.5, y - 0.5) < 0.02)
    model = Model(surfaces.container(faces, np.column_stack([x, y, z])))
    assert len(model.to_mesh().faces) < len(model.to_mesh(max_error="0.02%").faces)


def test_surfaces_without_faces_and_without_extent():
    none = Model(surfaces.container(np.empty((0, 3)), np.empty((0, 3))))
    for use in (none.to_mesh, lambda: none.contains([0, 0, 0]), lambda: none.nearest([0, 0, 0]), none.surface):
        with pytest.raises(SurfaceError, match="no faces"):
            use()
    point = Model(surfaces.container(surfaces.OCTAHEDRON, np.zeros((6, 3))))
    assert len(point.to_mesh(normals=True).faces) == 8
    assert not point.contains([0.1, 0, 0])
    with pytest.raises(SurfaceError, match="a point"):
        point.occupancy(16)


def test_by_default_triangles_are_not_too_many(monkeypatch):
    monkeypatch.setattr(representation, "MOST_FACES", 200)
    assert len(surfaces.ball().to_mesh().faces) == 128


def test_vertices_of_every_level_lie_on_the_limit():
    ball = surfaces.ball()
    finest = ball.surface(level=5).vertices
    for k in range(4):
        vertices = ball.surface(level=k).vertices
        np.testing.assert_allclose(finest[: len(vertices)], vertices, atol=1e-12)


def test_normals_of_meshes_keep_creases_sharp():
    mesh = surfaces.cube().to_mesh(normals=True)
    assert len(mesh.vertices) == 36  # all edges are sharp, the diagonals too
    of_faces = mesh.vertex_normals[mesh.faces]
    np.testing.assert_allclose(of_faces, np.repeat(mesh.face_normals[:, None], 3, axis=1), atol=1e-12)
    smooth = surfaces.ball().to_mesh(level=3, normals=True)
    assert smooth.is_watertight
    outward = smooth.vertices / np.linalg.norm(smooth.vertices, axis=1, keepdims=True)
    assert (smooth.vertex_normals * outward).sum(axis=1).min() > 0.98
    normals = surfaces.ball().normals(smooth.vertices)
    assert (normals * smooth.vertex_normals).sum(axis=1).min() > 0.9999


@pytest.mark.parametrize("name", ["contains", "implicit", "distance"])
def test_a_sheet_has_no_inside(name, points):
    sheet = loads(surfaces.sheet().dumps())
    with pytest.raises(SheetError, match="--thicken"):
        getattr(sheet, name)(points)
    with pytest.raises(SheetError, match="nearest points"):
        sheet.occupancy(16)


def test_faces_that_disagree_have_no_inside():
    faces = surfaces.OCTAHEDRON.copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(SheetError, match="disagree"):
        Model(surfaces.container(faces, surfaces.TIPS)).contains([[0, 0, 0]])


def test_what_a_sheet_answers():
    sheet = surfaces.sheet()
    mesh = sheet.to_mesh()
    assert not mesh.is_watertight
    point = np.array([0.5, 0.5, 1.0])
    near = sheet.nearest(point)
    assert near.distance == pytest.approx(1 - near.point[2], abs=0.02)
    hit = sheet.ray_intersect(point, [0, 0, -1])
    assert hit.point[2] == pytest.approx(0.1 * np.sin(3), abs=0.01)
    assert abs(hit.normal @ sheet.normals(hit.point)) > 0.99
