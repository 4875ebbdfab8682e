"""trimesh and meshio read `.cndhf` files once their module here is imported."""

from __future__ import annotations

import importlib
import io
import sys

import numpy as np
import pytest
import trimesh

from cndhf_codec import load
from cndhf_codec.errors import MissingExtraError, OptionError, SignatureError


@pytest.fixture
def path(golden):
    return golden / "encoded.cndhf"


def test_trimesh_by_path_and_by_stream(path):
    import cndhf_codec.integrations.trimesh  # noqa: F401

    expected = load(path).to_mesh(24)
    for mesh in (
        trimesh.load_mesh(path, resolution=24),
        trimesh.load(path, resolution=24, force="mesh"),
        trimesh.load_mesh(io.BytesIO(path.read_bytes()), file_type="cndhf", resolution=24),
    ):
        assert isinstance(mesh, trimesh.Trimesh)
        assert mesh.is_watertight
        np.testing.assert_array_equal(mesh.faces, expected.faces)
        np.testing.assert_allclose(mesh.vertices, expected.vertices)
    loaded = trimesh.load(path, resolution=16)  # a scene or a mesh: trimesh's own list of extensions decides
    assert (loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded).is_watertight


def test_trimesh_says_what_is_wrong(path, tmp_path):
    import cndhf_codec.integrations.trimesh  # noqa: F401

    with pytest.raises(OptionError, match="resolution is 7"):
        trimesh.load_mesh(path, resolution=7)
    (tmp_path / "a.cndhf").write_bytes(b"not one")
    with pytest.raises(SignatureError, match=r"a\.cndhf"):
        trimesh.load_mesh(tmp_path / "a.cndhf")


def test_meshio_is_not_part_of_any_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    monkeypatch.delitem(sys.modules, "cndhf_codec.integrations.meshio", raising=False)
    with pytest.raises(MissingExtraError, match="pip install meshio"):
        importlib.import_module("cndhf_codec.integrations.meshio")


def test_meshio(path, tmp_path, monkeypatch):
    meshio = pytest.importorskip("meshio")
    import cndhf_codec.integrations.meshio  # noqa: F401
    from cndhf_codec import Model

    small, to_mesh = load(path).to_mesh(24), Model.to_mesh
    monkeypatch.setattr(Model, "to_mesh", lambda self: to_mesh(self, 24))
    mesh = meshio.read(path)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], small.faces)
    np.testing.assert_allclose(mesh.points, small.vertices)
    mesh.write(tmp_path / "a.vtk")
    assert len(meshio.read(tmp_path / "a.vtk").points) == len(small.vertices)
    with open(path, "rb") as stream:
        assert len(meshio.read(stream, file_format="cndhf").points) == len(small.vertices)
    (tmp_path / "a.cndhf").write_bytes(b"not one")
    with pytest.raises(SignatureError, match=r"a\.cndhf"):
        meshio.read(tmp_path / "a.cndhf")
