"""Written mesh files hold what was decoded, whatever the position and the unit."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.decoder.meshfile import write_mesh


@pytest.mark.parametrize("extension", ["ply", "obj", "off", "glb", "stl"])
@pytest.mark.parametrize(("place", "size"), [(0, 1), (1e6, 1), (-3e5, 20), (0, 1e-4), (1, 1e-4), (0, 1e6), (0, 1e20)])
def test_relative_precision(tmp_path, extension, place, size):
    ball = trimesh.creation.icosphere(2)
    vertices = ball.vertices * size + [place, 0, -place]
    mesh = trimesh.Trimesh(vertices, ball.faces, process=False)
    path = tmp_path / f"a.{extension}"
    warning = write_mesh(mesh, path)
    back = trimesh.load(path, process=False, force="mesh")
    error = np.abs(back.triangles - mesh.triangles).max() / size
    if extension == "stl" and place:
        assert f"{path}: STL holds float32" in warning
        assert "write .ply" in warning
    else:
        assert warning is None
        assert error < 1e-6
    assert np.array_equal(back.faces.shape, mesh.faces.shape)


def test_near_the_origin_a_ply_is_float32(tmp_path):
    write_mesh(trimesh.creation.icosphere(2), tmp_path / "a.ply")
    assert b"property float x" in (tmp_path / "a.ply").read_bytes()
