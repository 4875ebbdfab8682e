"""The exact surface: double height fields as closed meshes, intersected."""

from __future__ import annotations

import analytic
import numpy as np
import pytest
import rawfile
import trimesh
from analytic import ABOUT_X_180, ABOUT_Y_90, ABOUT_Z_45, ring, slab, wavy

from cndhf_codec import Limits, load, loads
from cndhf_codec.decoder.dhf import intersection
from cndhf_codec.decoder.results import TriangleMesh
from cndhf_codec.errors import OptionError, SurfaceError

LO, HI = np.array([-0.5, -0.25, -0.125]), np.array([0.25, 0.5, 0.375])


def check_closed(mesh) -> None:
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0


def distances(model, mesh, n: int = 4000):
    """About how far points of the mesh are from the model's surface, in input units."""
    points = trimesh.sample.sample_surface(mesh, n, seed=0)[0]
    f, gradient = model.implicit(points, gradient=True)
    return np.abs(f) / np.linalg.norm(gradient, axis=1)


@pytest.mark.parametrize("quaternion", [analytic.NO_TURN, ABOUT_X_180, ABOUT_Y_90, (9000, -14000, 20000, 20000)])
def test_a_box_is_exact_and_has_twelve_triangles(quaternion):
    model = analytic.model(slab(LO, HI, quaternion), centre=(3, 4, 5), scale=10)
    mesh = model.to_mesh(method="intersection")
    check_closed(mesh)
    assert len(mesh.faces) == 12
    assert mesh.volume == pytest.approx(1000 * np.prod(HI - LO), rel=1e-5)


def test_creases_between_dhfs_are_kept():
    # Two slabs at 45 degrees: an octagonal prism's worth of creases that no grid is aligned with.
    a, b = slab((-0.5, -0.5, -0.25), (0.5, 0.5, 0.25)), slab((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), ABOUT_Z_45)
    mesh = analytic.model(a, b).to_mesh(method="intersection")
    check_closed(mesh)
    octagon = 8 * 0.5**2 * np.tan(np.pi / 8)
    assert mesh.volume == pytest.approx(octagon * 0.5, rel=1e-4)
    # Two octagons of 6 triangles, eight sides of 2.
    assert len(mesh.faces) == 28


@pytest.mark.parametrize("make", [wavy, ring], ids=["wavy", "ring"])
def test_the_error_asked_for_is_kept(make):
    model = make()
    volume = model.to_mesh(200).volume
    faces = []
    for error in (4e-3, 1e-3):
        mesh = model.to_mesh(method="intersection", max_error=error)
        check_closed(mesh)
        assert mesh.euler_number == (0 if make is ring else 2)
        assert mesh.volume == pytest.approx(volume, rel=2 * error)
        d = distances(model, mesh)
        assert d.mean() < error / 2
        assert np.percentile(d, 99) < error
        faces.append(len(mesh.faces))
    assert 2 * faces[0] < faces[1] < 20_000


def test_percent_is_of_the_diagonal_and_numbers_are_input_units():
    model = analytic.model(analytic.waves(7), scale=100)
    diagonal = np.linalg.norm(model.to_mesh(64).extents)
    absolute = model.to_mesh(method="intersection", max_error=0.002 * diagonal)
    relative = model.to_mesh(method="intersection", max_error="0.2%")
    assert len(relative.faces) == pytest.approx(len(absolute.faces), rel=0.02)


@pytest.mark.parametrize("faces", [100, 1000, 5000])
def test_a_number_of_faces(faces):
    mesh = wavy().to_mesh(method="intersection", faces=faces)
    check_closed(mesh)
    assert 0.5 * faces < len(mesh.faces) <= faces
    assert mesh.volume == pytest.approx(wavy().to_mesh(100).volume, rel=0.1 if faces == 100 else 0.01)


def test_far_fewer_triangles_than_marching_cubes():
    model = wavy()
    cubes, exact = model.to_mesh(128), model.to_mesh(method="intersection", max_error="0.01%")
    check_closed(exact)
    assert 4 * len(exact.faces) < len(cubes.faces)
    assert distances(model, exact).mean() < distances(model, cubes).mean()


def test_a_rough_model_from_the_encoder(golden):
    model = load(golden / "encoded.cndhf")
    mesh = model.to_mesh(method="intersection", max_error="0.1%")
    check_closed(mesh)
    assert mesh.volume == pytest.approx(model.to_mesh(128).volume, rel=0.005)


def test_bisection_fits_together_at_any_density():
    rng = np.random.default_rng(0)
    for levels in (1, 2, 5):
        n = 2**levels
        errors = intersection._nested(rng.random((n + 1, n + 1)).astype(np.float32) ** 4)
        for limit in (-1.0, 0.3, 0.9, 2.0):
            triangles = intersection.bisected(errors, limit)
            x, y = np.divmod(triangles, n + 1)
            area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
            assert np.all(area > 0)
            assert area.sum() == 2 * n * n
            # Every edge within the square belongs to two triangles, in opposite directions.
            edges = {(int(a), int(b)) for t in triangles for a, b in zip(t, np.roll(t, -1), strict=True)}
            assert len(edges) == 3 * len(triangles)
            alone = [(a, b) for a, b in edges if (b, a) not in edges]
            assert all(a // (n + 1) == b // (n + 1) in (0, n) or a % (n + 1) == b % (n + 1) in (0, n) for a, b in alone)


def test_a_plate_thinner_than_any_cell():
    model = analytic.model(slab((-0.5, -0.5, 0), (0.5, 0.5, 2**-10)))
    with pytest.warns(UserWarning, match="thinner than a cell"), pytest.raises(SurfaceError, match="than a voxel"):
        model.to_mesh(256)
    for options in ({}, {"max_error": 2**-12}, {"faces": 12}):
        mesh = model.to_mesh(method="intersection", **options)
        check_closed(mesh)
        assert len(mesh.faces) == 12
        assert mesh.volume == pytest.approx(2**-10, rel=1e-4)


def test_a_simplification_that_loses_volume_is_a_failure(monkeypatch):
    original = intersection._intersected

    class Shrunk:
        def __init__(self, whole):
            self.whole = whole

        def __getattr__(self, name):
            return getattr(self.whole, name)

        def simplify(self, tolerance):
            return self.whole.simplify(tolerance).scale((0.99,) * 3)

    monkeypatch.setattr(intersection, "_intersected", lambda *a: Shrunk(original(*a)))
    with pytest.warns(UserWarning, match="simplification changes its volume"):
        wavy().to_mesh(24, method="intersection")


@pytest.mark.encode
def test_solids_have_a_limit_of_vertices():
    model = loads(rawfile.noise(1, 8, 2), limits=Limits(vertices=100_000))
    with pytest.warns(UserWarning, match=r"no intersection \(this file asks for too much.*vertices"):
        mesh = model.to_mesh(16, method="intersection")
    assert len(mesh.vertices) < 10_000


def test_a_failure_falls_back_to_marching_cubes(monkeypatch):
    def fail(*_):
        raise SurfaceError("manifold3d refuses the intersection (NotManifold)")

    monkeypatch.setattr(intersection, "intersection", fail)
    with pytest.warns(UserWarning, match="NotManifold.*marching cubes"):
        mesh = wavy().to_mesh(24, method="intersection")
    assert np.array_equal(mesh.faces, wavy().to_mesh(24).faces)


def test_a_wrong_volume_is_a_failure(monkeypatch):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    monkeypatch.setattr(intersection, "intersection", lambda *_: TriangleMesh(box.vertices, box.faces))
    with pytest.warns(UserWarning, match="volume"):
        mesh = wavy().to_mesh(24, method="intersection")
    assert mesh.volume > 0.1


def test_open_meshes_are_refused_by_status(monkeypatch):
    original = intersection.DhfTriangulation.solid

    def opened(*arguments):
        vertices, faces = original(*arguments)
        return TriangleMesh(vertices, faces[1:])

    monkeypatch.setattr(intersection.DhfTriangulation, "solid", opened)
    with pytest.warns(UserWarning, match="NotManifold"):
        wavy().to_mesh(24, method="intersection")


def test_empty_solids():
    with pytest.raises(SurfaceError, match="empty"):
        analytic.model(slab((-0.5, -0.5, 0.25), (0.5, 0.5, -0.25))).to_mesh(method="intersection")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "cubes"}, "method is 'cubes'"),
        ({"method": "intersection", "max_error": 1.0, "faces": 100}, "not both"),
        ({"method": "intersection", "faces": 3}, "4 or more"),
        ({"method": "intersection", "faces": float("nan")}, "a whole number"),
        ({"method": "intersection", "max_error": 0}, "positive"),
        ({"method": "intersection", "max_error": "1mm"}, "positive"),
        ({"method": "intersection", "max_error": "nan%"}, "positive"),
        ({"method": "intersection", "resolution": 4}, "resolution is 4"),
    ],
)
def test_wrong_options(options, message):
    with pytest.raises(OptionError, match=message):
        wavy().to_mesh(**options)


@pytest.mark.parametrize("method", ["marching-cubes", "intersection"])
def test_normals_face_outward_along_the_gradient(method):
    model = wavy()
    mesh = model.to_mesh(40, method=method, normals=True)
    normals = mesh.vertex_normals.copy()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    agree = (normals * plain.vertex_normals).sum(axis=1)
    assert np.median(agree) > 0.999
    assert np.percentile(agree, 5) > 0.5  # on a crease, a mean of both sides against one of them
    step = 1e-3 * normals
    assert np.mean(model.implicit(mesh.vertices - step) > model.implicit(mesh.vertices + step)) > 0.99
