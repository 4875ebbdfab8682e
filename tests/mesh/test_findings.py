"""Finds of the mesh fuzzer (tools/fuzz/meshes.py): files that once raised an unnamed error, or warned."""

from __future__ import annotations

import io
import re
import struct
import zipfile

import pytest

from cndhf_codec.errors import MeshError
from cndhf_codec.mesh.formats import common
from cndhf_codec.mesh.read import read_mesh

# A triangle: its corners (0, 0, 0), (1, 0, 0), (0, 1, 0) are in the data URI.
GLTF = """{"asset": {"version": "2.0"}, "nodes": [NODE], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
"buffers": [{"byteLength": 36, "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}],
"bufferViews": [{"buffer": 0, "byteLength": 36}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}"""
FAR = 'transform="1e308 0 0 0 1e308 0 0 0 1 0 0 0"'
MODEL = """<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1"><mesh>
<vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/></vertices>
<triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object><object id="2"><components>
<component objectid="1" FAR/></components></object></resources>
<build><item objectid="1"/></build></model>""".replace("FAR", FAR)
STL = """solid a_b
facet normal 0 0 1 outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop endfacet
endsolid a_b
"""


def refusal(data: str | bytes) -> str:
    """Return the one line that says why it is not read; pytest makes warnings errors."""
    with pytest.raises(MeshError) as caught:
        read_mesh(io.BytesIO(data.encode() if isinstance(data, str) else data))
    assert str(caught.value).isprintable()
    return str(caught.value)


def gltf(node: str = '{"mesh": 0}', **changes: str) -> str:
    text = GLTF.replace("NODE", node)
    for old, new in changes.items():
        before = {"kind": '"VEC3"', "count": "3, ", "view": '"bufferView": 0, '}[old]
        assert text.count(before) == 1
        text = text.replace(before, new)
    return text


def threemf(text: str | bytes, name: str = "3D/3dmodel.model", method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr(name, text)
    return file.getvalue()


def test_the_files_are_read_unchanged():
    assert len(read_mesh(io.BytesIO(gltf().encode())).faces) == 1
    assert len(read_mesh(io.BytesIO(threemf(MODEL))).faces) == 1
    assert len(read_mesh(io.BytesIO(STL.encode())).faces) == 1


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (gltf(kind="[]"), "its type a list is not read"),
        (gltf(kind="{}"), "its type an object is not read"),
        (gltf(count="[" * 900 + "]" * 900 + ", "), "count is a list"),
        (gltf(view="", count="134217728, "), "134217728 elements and no data"),
        (gltf('{"mesh": 0}, 5'), "nodes holds what is no object"),
        (gltf('{"children": [1], "scale": [1e200, 1, 1]}, {"mesh": 0, "scale": [1e200, 1, 1]}'), "NaN or infinite"),
        (b"\0" * 80 + b"\1\0\0\0" + b"\1\0\x80\x7f" * 12 + b"\0\0", "NaN or infinite"),
        ("ply\nformat ascii 1.0\nelement a\x87 1\nend_header\n0\n".encode("latin-1"), r"asks of 'a\\x87'"),
        ("4OFF\n3 1\n1e308 0 0 1e-320\n1 0 0 1\n0 1 0 1\n3 0 1 2\n", "NaN or infinite"),
        ("v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 .5 0\nv 0 1e999 0\nf 1 2 3\nf 1 2 3 4 5\n", "NaN or infinite"),
        (STL.replace("1 0 0", "1_0 0 0"), "line 2: '1_0' is no number"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf\n", "has no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf # 1 2 3\n", "has no faces"),
        (threemf(MODEL.replace('<item objectid="1"', f'<item objectid="2" {FAR}')), "NaN or infinite"),
        (threemf(MODEL.replace("<item ", '<item transform="0 nan 0 -1e-320 nan 0 0 nan 0 0 0 0" ')), "NaN or infinite"),
        (threemf(MODEL, method=zipfile.ZIP_LZMA), "not compressed by Deflate"),
        (threemf(MODEL, method=zipfile.ZIP_BZIP2), "not compressed by Deflate"),
        (threemf('<?xml version="1.0" encoding="UTF-8UTF-8"?>' + MODEL), "of an encoding that is not read"),
        (threemf('<?xml version="1.0" encoding="utf-7"?>' + MODEL), "of an encoding that is not read"),
        (threemf(MODEL.replace('x="0"', 'x="?"'), "3D/a\n\x1b.model"),
         r"3d/a\\n\\x1b.model, line 2: '\?' is no number"),
    ],
)  # fmt: skip
def test_is_refused_with_a_reason(data, reason):
    assert re.search(reason, refusal(data))


def test_data_uris_are_bytes_not_text():
    corners = "%00" * 12 + "%00%00%80%3f" + "%00" * 12 + "%c3%a9%80%3f" + "%00" * 4  # 1, and a little more
    text = re.sub('"data:;base64,[^"]*"', f'"data:,{corners}"', gltf())
    found = read_mesh(io.BytesIO(text.encode()))
    assert found.vertices.max(axis=0).tolist() == [1, struct.unpack("<f", b"\xc3\xa9\x80\x3f")[0], 0]


def test_a_rotation_too_large_for_a_length_is_none():
    assert len(read_mesh(io.BytesIO(gltf('{"mesh": 0, "rotation": [1e200, 0, 0, 1e200]}').encode())).faces) == 1


def test_copies_and_their_vertices_are_counted(monkeypatch):
    monkeypatch.setattr(common, "MOST_COPIES", 2)
    nodes = ", ".join(['{"mesh": 0}'] * 4)
    assert "copies of its parts; at most 2" in refusal(gltf(nodes))
    components = '<component objectid="1"/>' * 4
    assert "copies of its parts; at most 2" in refusal(
        threemf(
            MODEL.replace("</components>", components + "</components>").replace(
                'item objectid="1"', 'item objectid="2"'
            )
        )
    )
    monkeypatch.setattr(common, "MOST_COPIES", 100)
    monkeypatch.setattr(common, "MOST_TRIANGLES", 10)
    unused = MODEL.replace("</vertices>", '<vertex x="0" y="0" z="0"/>' * 7 + "</vertices>")
    items = unused.replace("<build>", "<build>" + '<item objectid="1"/>' * 4)
    assert "40 vertices; at most 30" in refusal(threemf(items))


@pytest.mark.parametrize(
    "corners",
    [
        [1, 3, 2, 4, 5] * 6000,  # the sides cross
        [*range(1, 5001), 5001],  # all on a line but one
    ],
)
def test_polygons_of_thousands_of_corners(corners):
    """They took seconds; the first took more than the minute after which it was stopped."""
    vertices = "".join(f"v {k} 0 0\n" for k in range(5000)) + "v 0 1 0\n"
    if max(corners) < 6:
        vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 2 0\nv 3 1 1\n"
    mesh = read_mesh(io.BytesIO(f"{vertices}f {' '.join(map(str, corners))}\n".encode()))
    assert len(mesh.faces) > 100
    assert any("was guessed" in note for note in mesh.notes) == (max(corners) < 6)
