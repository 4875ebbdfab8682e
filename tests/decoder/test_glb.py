"""GLB files: what is written, and what they carry."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from cndhf_codec import load
from cndhf_codec.decoder.glb import Embedded, glb_bytes
from cndhf_codec.decoder.meshfile import write_mesh
from cndhf_codec.errors import MeshError, OptionError
from cndhf_codec.mesh.read import read_mesh


def parts(data: bytes) -> tuple[dict, bytes]:
    """The two chunks, whose lengths are checked."""
    magic, version, length, n_text, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
    n_body, kind = struct.unpack_from("<II", data, 20 + n_text)
    assert (28 + n_text + n_body, kind, n_text % 4, n_body % 4) == (length, 0x004E4942, 0, 0)
    return json.loads(data[20 : 20 + n_text]), data[28 + n_text :]


def carried(data: bytes) -> bytes:
    """The .cndhf file in a GLB."""
    root, body = parts(data)
    view = root["bufferViews"][root["meshes"][0]["primitives"][0]["extensions"]["CNDHF_shape"]["bufferView"]]
    assert set(view) == {"buffer", "byteOffset", "byteLength"}
    assert root["buffers"] == [{"byteLength": len(body)}]
    return body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def test_a_triangle_byte_by_byte():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
    data = glb_bytes(vertices, np.array([[0, 1, 2]]), None, np.zeros(3), Embedded(b"12345"))
    root, body = parts(data)
    assert root["accessors"] == [
        {"bufferView": 0, "count": 3, "componentType": 5126, "type": "VEC3", "min": [0, 0, 0], "max": [1, 2, 0]},
        {"bufferView": 1, "count": 3, "componentType": 5125, "type": "SCALAR"},
    ]
    assert root["meshes"][0]["primitives"] == [
        {"attributes": {"POSITION": 0}, "material": 0, "indices": 1, "extensions": {"CNDHF_shape": {"bufferView": 2}}}
    ]
    assert root["nodes"] == [{"mesh": 0}]
    assert root["extensionsUsed"] == ["CNDHF_shape"]
    assert "extensionsRequired" not in root
    assert body == struct.pack("<9f3I", 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 1, 2) + b"12345\0\0\0"


@pytest.mark.parametrize("name", ["encoded", "surface"])  # the second one is far from the origin
def test_a_fallback_is_read_as_any_mesh(golden, tmp_path, name):
    model = load(golden / f"{name}.cndhf")
    mesh = model.to_mesh(faces=400, normals=True)
    write_mesh(mesh, tmp_path / "a.glb", with_normals=True, embedded=Embedded(model.dumps()))
    read = read_mesh(tmp_path / "a.glb")
    # The reader orders vertices and faces anew.
    middles, wanted = read.vertices[read.faces].mean(axis=1), mesh.triangles.mean(axis=1)
    assert len(middles) == len(wanted)
    distances = np.linalg.norm(middles[:, None] - wanted, axis=2)
    assert max(distances.min(axis=0).max(), distances.min(axis=1).max()) < 1e-6 * model.info["scale"]
    data = (tmp_path / "a.glb").read_bytes()
    assert carried(data) == model.dumps()
    root, _ = parts(data)
    place = root["nodes"][0].get("translation")
    assert (place is not None) == (name == "surface")
    assert root["meshes"][0]["primitives"][0]["extensions"]["CNDHF_shape"].get("origin") == place


def test_without_a_fallback(golden, tmp_path):
    model = load(golden / "encoded.cndhf")
    mesh = model.to_mesh(faces=400)
    write_mesh(mesh, tmp_path / "a.glb", embedded=Embedded(model.dumps(), fallback=False))
    data = (tmp_path / "a.glb").read_bytes()
    assert carried(data) == model.dumps()
    assert len(data) < len(model.dumps()) + 1024
    root, _ = parts(data)
    assert root["extensionsUsed"] == root["extensionsRequired"] == ["CNDHF_shape"]
    (accessor,) = root["accessors"]
    assert "bufferView" not in accessor
    assert accessor["count"] == 3
    np.testing.assert_allclose([accessor["min"], accessor["max"]], mesh.bounds, rtol=1e-6)
    with pytest.raises(MeshError, match="requires the glTF extension 'CNDHF_shape'"):
        read_mesh(tmp_path / "a.glb")


def test_other_formats_carry_no_file(golden, tmp_path):
    mesh = load(golden / "encoded.cndhf").to_mesh(16)
    with pytest.raises(OptionError, match="carries no"):
        write_mesh(mesh, tmp_path / "a.ply", embedded=Embedded(b""))
