"""Reading mesh files and arrays: the same solid from every kind of source, and a named error from every bad one."""

from __future__ import annotations

import gzip
import io

import numpy as np
import pytest
import trimesh
from shapes import lumps, write_every_format

from cndhf_codec.errors import InputError, MeshError
from cndhf_codec.mesh.read import read_mesh


@pytest.fixture
def box():
    mesh = trimesh.creation.box((1, 2, 3))
    mesh.apply_translation((10, 20, 30))
    return mesh


def solid(mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def check_is_the_box(mesh) -> None:
    assert mesh.vertices.shape == (8, 3)
    assert mesh.faces.shape == (12, 3)
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    np.testing.assert_allclose(solid(mesh).bounds, [[9.5, 19, 28.5], [10.5, 21, 31.5]], atol=1e-5)
    assert solid(mesh).is_watertight
    assert solid(mesh).volume == pytest.approx(6)


@pytest.mark.parametrize("extension", ["obj", "ply", "stl", "off", "glb", "OBJ", "Ply"])
def test_files(tmp_path, box, extension):
    path = tmp_path / f"box.{extension}"
    box.export(path, file_type=extension.lower())
    check_is_the_box(read_mesh(path))
    check_is_the_box(read_mesh(str(path)))
    assert read_mesh(path).name == str(path)


def test_objects_and_arrays(box):
    check_is_the_box(read_mesh(box))
    check_is_the_box(read_mesh((box.vertices, box.faces)))
    check_is_the_box(read_mesh((box.vertices.tolist(), box.faces.tolist())))


def test_soup_is_welded_by_position(box):
    check_is_the_box(read_mesh((box.triangles.reshape(-1, 3), np.arange(36).reshape(12, 3))))


def test_minus_zero_is_zero(box):
    soup = box.triangles.reshape(-1, 3) - [9.5, 19, 28.5]
    soup[::2] *= np.where(soup[::2] == 0, -1, 1)
    assert np.signbit(soup[soup == 0]).any()
    assert len(read_mesh((soup, np.arange(36).reshape(12, 3))).vertices) == 8


def test_unused_vertices_are_dropped(box):
    vertices = np.concatenate([[[1e9, np.nan, 0]], box.vertices])
    check_is_the_box(read_mesh((vertices, box.faces + 1)))


def test_faces_of_zero_area_are_dropped_at_any_scale(box):
    for scale in (1e-12, 1, 1e12):
        faces = np.concatenate([box.faces, [[0, 0, 1], [2, 2, 2]]])
        mesh = read_mesh((box.vertices * scale, faces))
        assert (len(mesh.faces), mesh.dropped) == (12, 2)


@pytest.mark.parametrize("as_file", [False, True])
def test_scenes_are_flattened_with_their_transforms(tmp_path, as_file):
    unit = trimesh.creation.box()
    scene = trimesh.Scene()
    scene.add_geometry(unit, node_name="a")
    scene.add_geometry(unit, node_name="b", transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(unit, node_name="c", transform=trimesh.transformations.scale_matrix(3))
    source = scene
    if as_file:
        source = tmp_path / "scene.glb"
        scene.export(source)
    mesh = read_mesh(source)
    assert len(mesh.faces) == 36
    np.testing.assert_allclose(solid(mesh).bounds, [[-1.5] * 3, [5.5, 1.5, 1.5]])


def test_formats_and_orders_do_not_matter(tmp_path):
    mesh = lumps()
    first = read_mesh(mesh)
    for path in write_every_format(mesh, tmp_path):
        other = read_mesh(path)
        assert np.array_equal(other.vertices, first.vertices), path
        assert np.array_equal(other.faces, first.faces), path


def test_orientation_survives_the_sorting(box):
    inverted = trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)
    assert solid(read_mesh(inverted)).volume == pytest.approx(-6)


def test_quads_in_a_file_become_triangles(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    mesh = read_mesh(path)
    assert solid(mesh).area == pytest.approx(1)
    assert len(mesh.faces) == 2


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(InputError, match=r"gone\.obj: no such file"):
        read_mesh(tmp_path / "gone.obj")
    with pytest.raises(InputError, match="is a folder"):
        read_mesh(tmp_path)
    with pytest.raises(InputError, match="nnn: "):
        read_mesh(tmp_path / ("n" * 256))


@pytest.mark.parametrize("name", ["a.step", "a.txt", "a.cndhf"])
def test_unknown_extensions(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError, match=r"unknown mesh extension.*\.obj"):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("extension", ["obj", "ply", "stl", "off", "glb"])
@pytest.mark.parametrize("content", [b"", b"not a mesh at all\n" * 20])
def test_files_that_hold_no_mesh(tmp_path, extension, content):
    path = tmp_path / f"bad.{extension}"
    path.write_bytes(content)
    with pytest.raises(MeshError, match=rf"bad\.{extension}: ") as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("extension", ["ply", "glb"])
def test_files_cut_short(tmp_path, box, extension):
    path = tmp_path / f"cut.{extension}"
    box.export(path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(MeshError, match=rf"cut\.{extension}: "):
        read_mesh(path)


@pytest.mark.parametrize("extension", ["obj", "ply", "off", "glb"])
def test_files_without_faces(tmp_path, extension):
    content = {
        "obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n",
        "off": "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n",
        "glb": "glTF",
    }[extension]
    (tmp_path / f"none.{extension}").write_text(content)
    with pytest.raises(MeshError, match=rf"none\.{extension}: "):
        read_mesh(tmp_path / f"none.{extension}")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"),
        ("inf.off", "OFF\n3 1 0\ninf 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
        ("beyond.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("beyond.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n"),
        ("text.ply", "Dear reader,\nthis is no mesh.\n"),
    ],
)
def test_files_of_bad_meshes(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshError, match=name.replace(".", r"\.")) as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_point_clouds_and_curves(tmp_path, box):
    trimesh.PointCloud(box.vertices).export(tmp_path / "points.ply")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    for name in ("points.ply", "line.obj"):
        with pytest.raises(MeshError, match=f"{name}: holds no triangles"):
            read_mesh(tmp_path / name)
    with pytest.raises(MeshError, match="no triangles"):
        read_mesh(trimesh.Scene())


V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ((np.where(V == 1, np.nan, V), F), "NaN or infinite"),
        ((np.where(V == 1, np.inf, V), F), "NaN or infinite"),
        ((V, F + 1), "names vertex 4, but there are 4"),
        ((V, F - 1), "names vertex -1, but there are 4"),
        ((V, F + 0.5), "not whole"),
        ((V, F * np.nan), "not whole"),
        ((V, np.where(F == 3, np.inf, F)), "not whole"),
        ((V, np.where(F == 3, 1e30, F)), "not whole"),
        ((V + 1j, F), "arrays of numbers"),
        ((V, F[:0]), "no faces"),
        ((V[:0], F), "names vertex 3, but there are 0"),
        ((V[:, :2], F), "shape"),
        ((V, np.zeros((2, 4), int)), "shape"),
        ((V * [1, 1e-14, 0], F), "zero area"),
        ((V * 0, F), "zero area"),
        ((V, [[0, 1, 2], [0, 1]]), "arrays of numbers"),
        (([["a", "b", "c"]] * 4, F), "arrays of numbers"),
        (None, "cannot make a mesh of a NoneType"),
        ([V, F], "cannot make a mesh of a list"),
        (V, "cannot make a mesh of a ndarray"),
    ],
)
def test_arrays_that_are_no_mesh(source, message):
    with pytest.raises(MeshError, match=message):
        read_mesh(source)


class Slow(io.RawIOBase):
    """A stream that gives a few bytes at a time, as pipes do."""

    def __init__(self, data: bytes) -> None:
        self.rest = data

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        given, self.rest = self.rest[: min(100, size)], self.rest[min(100, size) :]
        return given


def test_streams(tmp_path, box):
    for kind in ("ply", "obj", "stl", "glb", "off"):
        data = box.export(file_type=kind)
        data = data.encode() if isinstance(data, str) else data
        check_is_the_box(read_mesh(io.BytesIO(data)))
        check_is_the_box(read_mesh(Slow(data)))
    (tmp_path / "a.ply").write_bytes(box.export(file_type="ply"))
    with open(tmp_path / "a.ply", "rb") as file:
        check_is_the_box(read_mesh(file))
    packed = gzip.compress(box.export(file_type="ply"))
    check_is_the_box(read_mesh(gzip.GzipFile(fileobj=io.BytesIO(packed))))
    with pytest.raises(InputError, match="the stream: cannot be read: "):
        read_mesh(gzip.GzipFile(fileobj=io.BytesIO(packed[:-20])))
    with pytest.raises(InputError, match="is not open for bytes"):
        read_mesh(io.StringIO("v 0 0 0"))
    with pytest.raises(MeshError, match="the stream: is empty"):
        read_mesh(io.BytesIO())
    file.close()
    with pytest.raises(InputError, match=r"cannot be read: .*closed file"):
        read_mesh(file)
    with pytest.raises(MeshError, match=r"the stream: its content is of no format that is read: obj, ply"):
        read_mesh(io.BytesIO(b"Dear reader,"))


def test_what_else_a_file_holds_is_named(tmp_path):
    ball = trimesh.creation.icosphere(1)
    ball.visual.vertex_colors = np.full((len(ball.vertices), 4), 255, dtype=np.uint8)
    for extension in ("ply", "glb", "obj"):
        ball.export(tmp_path / f"a.{extension}")
        assert "colours" in read_mesh(tmp_path / f"a.{extension}").lost, extension
    ball.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(ball.vertices), 2)))
    ball.export(tmp_path / "b.glb")
    assert {"texture coordinates", "materials"} <= set(read_mesh(tmp_path / "b.glb").lost)
    trimesh.creation.box().export(tmp_path / "c.stl")
    assert read_mesh(tmp_path / "c.stl").lost == ()
