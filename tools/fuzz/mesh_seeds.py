"""Small valid mesh files for `meshes.py`, made here: every format, and every feature of it that is read."""

from __future__ import annotations

import base64
import bz2
import gzip
import io
import json
import lzma
import math
import struct
import zipfile
from typing import Any
from urllib.parse import quote

import mesh_target
import numpy as np
import zstandard

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint16)
STRIP = np.array([0, 1, 2, 3, 0, 1], dtype=np.uint8)
TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

OBJ = (
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    "# a comment\nmtllib a.mtl\no x\nv 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nv 0 0 1 1\ns off\n"
    "f -4 -2 -3\nf -4 -3 -1\nl 1 2\np 1\n",
    "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 .5 0\nv 0 2 0\nv 1 1 3\nvt 0 0\nvn 0 0 1\ng a b\nusemtl c\n"
    "f 5/1/1 4/1/1 3/1/1 2/1/1 1/1/1\n"
    "f 1//1 2//1 6//1\nf 2/1 3/1 6/1\nf 3 4 6\nf 4 5 6\nf 5 1 6\n",
    "v 0 0 0\nv 1 0 \\\n0\r\nv 0 1 0\r\nfo 1 2 \\\n 3 # a face\r\nwhat is this\r\n",
    "V 0 0 0\nV 4 0 0\nV 4 4 0\nV 0 4 0\nV 1 1 0\nV 3 1 0\nV 3 3 0\nV 1 3 0\nF 1 2 3 4 1 5 8 7 6 5\nF 1 3 2 4\nF 1 2\n",
    "v 1e-3 -2.5E2 +.5\nv 1 0 0\nv 0 1 0\nv 0 1 0\nf 1 2 3\nf 1 2 4 3\nf 1 2 3\ncstype bezier\n",
)
OFF = (
    "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n",
    "COFF 4 2 0 # colours\n0 0 0 255 0 0 255\n1 0 0 0 0 0 0\n1 1 0 1 1 1 1\n0 1 0 0 0 0 0\n"
    "4 0 1 2 3 0.5 0.5 0.5\n3 0 1 2 7\n",
    "4OFF\n4 1\n0 0 0 1\n2 0 0 2\n0 3 0 1\n0 0 1 .5\n3 0 1 2\n",
    "STCNOFF\n3 1 3\n0 0 0 0 0 1 0 0 0 1 0 0\n1 0 0 0 0 1 0 0 0 1 1 0\n0 1 0 0 0 1 0 0 0 1 0 1\n3 0 1 2\nmore\n",
    "OFF\n3 1 0\n0 0 0\n1 0\n0 0 1 0\n3 0\n1 2 7\n",
    "OFF BINARY\n1 1 0\n",
    "3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n2 0 1\n",
)
PLY_HEADER = "comment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
ROWS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
PLY_ASCII = (
    f"ply\nformat ascii 1.0\n{PLY_HEADER}element face 2\nproperty list uchar int vertex_indices\n"
    f"end_header\n{ROWS}3 0 1 2\n3 0 2 3\n",
    f"ply\r\nformat ascii 1.0\r\n{PLY_HEADER}element face 3\nproperty uchar red\nproperty list uchar int vertex_index\n"
    f"end_header\n{ROWS}7 4 0 1 2 3\n7 3 0 1 2\n0 2 0 1\n".replace("\r\n", "\n").replace("\n", "\r\n"),
    f"ply\nformat ascii 1.0\n{PLY_HEADER}element tristrips 1\nproperty list int int vertex_indices\nelement edge 1\n"
    f"property int vertex1\nproperty int vertex2\nend_header\n{ROWS}9 0 1 2 3 -1 2 1 0 3\n0 1\nmore\n",
)
PLY_ASCII += (
    f"ply\nformat ascii 1.0\n{PLY_HEADER}element face 1\nproperty list uchar int vertex_indices\nelement tristrips 1\n"
    f"property list int int vertex_indices\nend_header\n{ROWS}3 0 1 2\n4 0 1 2 3\n",
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty list int float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n1 0 0 0\n3 0 0 0\n",
)
STL_ASCII = (
    "solid a b\n"
    + "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n" * 2
    + "endsolid a b\nsolid\nfacet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1e0 0 0\n  vertex 0 0 1\n"
    " endloop\nendfacet\nendsolid\n",
    "SOLID\rFACET NORMAL 0 0 0\rOUTER LOOP\rVERTEX 0 0 0\rVERTEX 1 0 0\rVERTEX 0 1 0\rENDLOOP\rENDFACET\r",
)
MODEL = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xmlns="{core}" xmlns:p="{production}" '
    'xmlns:m="{material}" requiredextensions="p m">\n<resources>\n{resources}</resources>\n'
    "<build>\n{build}</build>\n</model>"
)
SPACE = "http://schemas.microsoft.com/3dmanufacturing"
TURN = 'transform="0 1 0 -1 0 0 0 0 1 5 6 7"'
MIRROR = 'transform="-1 0 0 0 1 0 0 0 1 0 0 0"'


def obj_like() -> list[tuple[str, bytes]]:
    texts = [("obj", OBJ), ("off", OFF), ("ply", PLY_ASCII), ("stl", STL_ASCII)]
    out = [(kind, text.encode()) for kind, some in texts for text in some]
    comb = "".join(f"v {k} {40 * (k % 2)} 0\n" for k in range(80)) + "v 0 -9 0\nf " + " ".join(map(str, range(1, 82)))
    odd = [b"\xff\xfe" + OBJ[0].encode("utf-16-le"), b"\xef\xbb\xbf" + OBJ[0].encode(), comb.encode()]
    return [*out, *(("obj", data) for data in odd), ("obj", b"<?xml version='1.0'?><COLLADA/>")]


def ply_binary() -> list[tuple[str, bytes]]:
    out = []
    for order, name in (("<", "little"), (">", "big")):
        head = f"ply\nformat binary_{name}_endian 1.0\n{PLY_HEADER}"
        points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=order + "f4").tobytes()
        lists = {  # alike, mixed, strips
            "element face 2\nproperty list uchar int vertex_indices\n": [(0, 1, 2), (0, 2, 3)],
            "element face 3\nproperty list uchar int vertex_indices\n": [(0, 1, 2, 3), (0, 1, 2), (1, 2)],
            "element tristrips 1\nproperty list uchar int vertex_indices\n": [(0, 1, 2, 3, -1, 2, 1, 0)],
        }
        for element, rows in lists.items():
            body = b"".join(struct.pack(f"{order}B{len(row)}i", len(row), *row) for row in rows)
            out.append((f"{head}{element}end_header\n").encode() + points + body)
        extra = struct.pack(f"{order}hB3HdB3HdB", 1, 3, 0, 1, 2, 0.5, 4, 0, 1, 2, 1.5, 0)
        element = "element other 1\nproperty short a\nelement face 1\nproperty list uint8 uint16 vertex_index\n"
        element += "property double b\nproperty list uchar ushort c\n"
        out.append((f"{head}{element}end_header\n").encode() + points + extra)
    return [("ply", data) for data in out]


def stl_binary() -> list[tuple[str, bytes]]:
    triangles = CORNERS[FACES]
    body = b"".join(struct.pack("<3f9fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles)
    whole = b"solid by hand".ljust(80) + struct.pack("<I", 4) + body
    return [("stl", whole), ("stl", whole + b"more"), ("stl", whole[:-1])]


class Glb:
    """A document of one scene, put together piece by piece."""

    def __init__(self) -> None:
        self.binary = b""
        self.root: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "buffers": [{"byteLength": 0}],
        }

    def add(self, what: str, item: dict[str, Any]) -> int:
        self.root.setdefault(what, []).append(item)
        return len(self.root[what]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        at = len(self.binary)
        self.binary += data + bytes(-len(data) % 4)
        self.root["buffers"][0]["byteLength"] = len(self.binary)
        return self.add("bufferViews", {"buffer": 0, "byteOffset": at, "byteLength": len(data), **more})

    def accessor(self, array: np.ndarray, **more: Any) -> int:
        """Of (n,) or (n, width) numbers."""
        width = 1 if array.ndim == 1 else array.shape[1]
        data = {} if "sparse" in more else {"bufferView": self.view(array.tobytes())}
        kind = {"componentType": TYPES[array.dtype.str[1:]], "type": SHAPES[width], "count": len(array)}
        return self.add("accessors", {**data, **kind, **more})

    def mesh(self, primitive: dict[str, Any], **node: Any) -> int:
        """A mesh of one primitive, and the node that shows it."""
        return self.add("nodes", {"mesh": self.add("meshes", {"primitives": [primitive]}), **node})

    def glb(self) -> bytes:
        return pack_glb([(b"JSON", json.dumps(self.root).encode()), (b"BIN\0", self.binary)])

    def gltf(self, uri: str | None = None) -> bytes:
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        self.root["buffers"][0]["uri"] = uri
        return json.dumps(self.root).encode()


def pack_glb(chunks: list[tuple[bytes, bytes]], version: int = 2) -> bytes:
    body = b""
    for name, data in chunks:
        data += (b" " if name == b"JSON" else b"\0") * (-len(data) % 4)
        body += struct.pack("<I4s", len(data), name) + data
    return struct.pack("<4sII", b"glTF", version, 12 + len(body)) + body


def plain() -> Glb:
    made = Glb()
    made.mesh({"attributes": {"POSITION": made.accessor(CORNERS)}, "indices": made.accessor(FACES.ravel())})
    return made


def gltf_kin() -> list[tuple[str, bytes]]:
    out = [plain()]
    for mode, indices in ((5, STRIP), (6, STRIP[:4]), (4, None), (1, STRIP)):  # strip, fan, soup, lines and a list
        made = Glb()
        points = CORNERS if indices is not None else CORNERS[FACES].reshape(-1, 3)
        primitive: dict[str, Any] = {"attributes": {"POSITION": made.accessor(points)}, "mode": mode}
        if indices is not None:
            primitive["indices"] = made.accessor(indices)
        made.mesh(primitive)
        if mode == 1:
            made.root["meshes"][0]["primitives"].append({**primitive, "mode": 4})
        out.append(made)
    out += [sparse(), quantised(), interleaved(), morphed(), skinned(), instanced(), tree()]
    compressed = plain()
    compressed.root["meshes"][0]["primitives"][0]["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}
    }
    del compressed.root["accessors"][0]["bufferView"]
    bare = skinned()
    del bare.root["skins"][0]["inverseBindMatrices"]
    attributes = bare.root["meshes"][0]["primitives"][0]["attributes"]
    attributes.update(JOINTS_1=attributes["JOINTS_0"], WEIGHTS_1=attributes["WEIGHTS_0"])
    texts = [
        plain().gltf(),
        bare.gltf(),
        skinned().gltf("data:,abc"),
        plain().gltf("a.bin"),
        plain().gltf("data:," + quote(plain().binary)),
    ]
    glbs = [made.glb() for made in (*out, compressed)]
    return [*(("glb", data) for data in [*glbs, glbs[0] + b"more"]), *(("gltf", data) for data in texts)]


def sparse() -> Glb:
    made = Glb()
    made.root["accessors"] = []
    indices = made.view(np.array([1, 3], dtype=np.uint16).tobytes())
    values = made.view(CORNERS[[1, 3]].tobytes())
    about = {"count": 2, "indices": {"bufferView": indices, "componentType": 5123}, "values": {"bufferView": values}}
    base = made.view(CORNERS[[0, 0, 2, 0]].tobytes())
    for more in ({"bufferView": base}, {}):
        position = made.accessor(CORNERS, sparse=about, **more, min=[0, 0, 0], max=[1, 1, 1])
        made.mesh({"attributes": {"POSITION": position}, "indices": made.accessor(FACES.ravel())})
    made.root["scenes"][0]["nodes"] = [0, 1]
    return made


def quantised() -> Glb:
    made = Glb()
    made.root["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_materials_unlit"]
    for kind, largest in (("u2", 65535), ("i1", 127)):
        points = (CORNERS * largest).astype(kind)
        position = made.accessor(points, normalized=True, min=[0, 0, 0], max=[largest] * 3)
        made.mesh({"attributes": {"POSITION": position}, "indices": made.accessor(FACES.ravel())}, scale=[2, 3, -4])
    made.root["scenes"][0]["nodes"] = [0, 1]
    return made


def interleaved() -> Glb:
    made = Glb()
    rows = np.hstack([np.ones_like(CORNERS), CORNERS])  # normals, positions
    view = made.view(rows.tobytes(), byteStride=24)
    about = {"bufferView": view, "byteOffset": 12, "componentType": 5126, "type": "VEC3", "count": 4}
    made.mesh({"attributes": {"POSITION": made.add("accessors", about)}, "indices": made.accessor(FACES.ravel())})
    return made


def morphed() -> Glb:
    made = Glb()
    targets = [{"POSITION": made.accessor(CORNERS * k)} for k in (1, -1)]
    primitive = {"attributes": {"POSITION": made.accessor(CORNERS)}, "indices": made.accessor(FACES.ravel())}
    made.mesh({**primitive, "targets": targets}, weights=[0.5, 0.25])
    made.root["meshes"][0]["weights"] = [1, 0]
    made.add("nodes", {"mesh": 0})
    made.root["scenes"][0]["nodes"] = [0, 1]
    return made


def skinned() -> Glb:
    made = Glb()
    joints = np.array([[0, 1, 0, 0]] * 4, dtype=np.uint8)
    weights = np.array([[0.5, 0.5, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]], dtype=np.float32)
    attributes = {
        "POSITION": made.accessor(CORNERS),
        "JOINTS_0": made.accessor(joints),
        "WEIGHTS_0": made.accessor(weights),
    }
    made.mesh({"attributes": attributes, "indices": made.accessor(FACES.ravel())}, skin=0)
    made.add("nodes", {"translation": [1, 2, 3], "children": [2]})
    made.add("nodes", {"rotation": [0, 0, math.sqrt(0.5), math.sqrt(0.5)]})
    inverse = made.accessor(np.tile(np.eye(4, dtype=np.float32).ravel(), (2, 1)))
    made.root["skins"] = [{"joints": [1, 2], "inverseBindMatrices": inverse}]
    made.root["scenes"][0]["nodes"] = [0, 1]
    return made


def instanced() -> Glb:
    made = plain()
    made.root["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    attributes = {
        "TRANSLATION": made.accessor(CORNERS * 5),
        "ROTATION": made.accessor(np.array([[0, 0, 0, 127]] * 4, dtype=np.int8), normalized=True),
        "SCALE": made.accessor(CORNERS + 1),
    }
    made.root["nodes"][0].update(
        extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}}, translation=[1, 1, 1]
    )
    return made


def tree() -> Glb:
    made = plain()
    made.root["nodes"] = [
        {"children": [1, 2, 4], "matrix": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]},
        {"mesh": 0, "scale": [1, 2, 3], "rotation": [0, 1, 0, 0]},
        {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}, "children": [3]},
        {"mesh": 0},
        {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
        {"mesh": 0},
    ]
    made.root["scenes"].append({"nodes": [5]})
    return made


def threemf() -> list[tuple[str, bytes]]:
    points = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*row) for row in CORNERS.tolist())
    faces = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*row) for row in FACES.tolist())
    mesh = f"<mesh><vertices>{points}</vertices><triangles>{faces}</triangles></mesh>"
    one = f'<object id="1" type="model">{mesh}</object>\n'
    group = (
        f'<object id="2"><components><component objectid="1" {TURN}/><component objectid="1"/></components></object>\n'
        f'<object id="3"><components><component objectid="2" {MIRROR}/></components></object>\n'
        f'<object id="4" type="support">{mesh}</object>\n<m:basematerials id="9"/>\n'
    )
    item = '<item objectid="1"/>\n'
    far = f'<object id="7"><components><component p:path="/3D/b.model" objectid="1" {TURN}/></components></object>\n'
    packages = (
        {"3D/3dmodel.model": (one, item)},
        {"3D/3dmodel.model": (one + group, f'<item objectid="3" {TURN}/><item objectid="4"/><item objectid="2"/>')},
        {"/3D/other.model": (one, item), "[Content_Types].xml": ("", "")},
        {"3D/3dmodel.model": (group.replace('d="1"', 'd="3"'), item.replace("1", "2"))},  # within itself
        {"3D/3dmodel.model": (one.replace("</mesh>", "<m:beamlattice/></mesh>"), item)},
        {"3D/3dmodel.model": (far, '<item objectid="7"/>'), "3D/b.model": (one, "")},
    )
    out = []
    names = {"core": f"{SPACE}/core/2015/02", "production": f"{SPACE}/production/2015/06"}
    names["material"] = f"{SPACE}/material/2015/02"
    for package in packages:
        parts = {path: MODEL.format(resources=r, build=b, **names).encode() for path, (r, b) in package.items()}
        out += [pack_zip(parts, zipfile.ZIP_DEFLATED), pack_zip(parts, zipfile.ZIP_STORED)]
    return [("3mf", data) for data in out]


def pack_zip(parts: dict[str, bytes], method: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in parts.items():
            archive.writestr(zipfile.ZipInfo(name), data, method)  # of a fixed date
    return file.getvalue()


PACKERS = {
    b"\x1f\x8b": lambda data: gzip.compress(data, 1, mtime=0),
    b"BZh": lambda data: bz2.compress(data, 1),
    b"\xfd7zXZ\0": lambda data: lzma.compress(data, preset=0),
    b"\x28\xb5\x2f\xfd": lambda data: zstandard.ZstdCompressor(level=1).compress(data),
}


def seeds() -> list[bytes]:
    """Inputs of the fuzzer: every file as a stream's and by its name, some with the wrong name, some compressed."""
    files = [*obj_like(), *ply_binary(), *stl_binary(), *gltf_kin(), *threemf()]
    kinds = list(mesh_target.KINDS)
    out = [bytes([0]) + data for _, data in files]
    out += [bytes([kinds.index(kind)]) + data for kind, data in files]
    for at, pack in enumerate(PACKERS.values()):
        out += [bytes([0]) + pack(data) for _, data in files[at :: 2 * len(PACKERS)]]
    return out
