"""Make the mesh files of this folder and index.tsv: `python tests/trials/make.py`.

Each file is a way of writing a mesh that people use and that readers get wrong, or damage that they take for a mesh.
index.tsv says what is right: volume, area and box of what is read, a part of its note, or a part of the error's text.
The files are frozen: to change one is to change what was tested before.
"""

from __future__ import annotations

import base64
import bz2
import csv
import gzip
import io
import json
import lzma
import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

HERE = Path(__file__).parent

# An L of 4 x 3 with arms of one, and a U, both concave; pushed up by one.
L = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]
U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
L_IS = {"volume": 6, "area": 26, "box": "0 0 0 4 3 1"}
U_IS = {"volume": 7, "area": 30, "box": "0 0 0 3 3 1"}
BOX_IS = {"volume": 1, "area": 6, "box": "0 0 0 1 1 1"}
L_TRIANGLES = [(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)]  # of the outline


def prism(outline: Sequence[tuple[int, int]], turn: int = 0) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices and polygons of an outline extruded by one. turn: the corner that its two ends begin with."""
    n = len(outline)
    vertices = np.array([(x, y, z) for z in (0, 1) for x, y in outline], dtype=float)
    ring = [(k + turn) % n for k in range(n)]
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    return vertices, [ring[::-1], [n + k for k in ring], *sides]


def triangles(vertices: np.ndarray, polygons: list[list[int]]) -> list[list[int]]:
    """Triangles of the L's polygons; its ends are divided by hand."""
    ends = [[[c, b, a] for a, b, c in L_TRIANGLES], [[6 + k for k in t] for t in L_TRIANGLES]]
    return [*ends[0], *ends[1], *(t for a, b, c, d in polygons[2:] for t in ([a, b, c], [a, c, d]))]


V, POLYGONS = prism(L)
F = triangles(V, POLYGONS)
CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CUBE_FACES = [face for a, b, c, d in CUBE_QUADS for face in ([a, b, c], [a, c, d])]

rows: list[dict[str, Any]] = []


def put(name: str, data: bytes | str, note: str = "", error: str = "", **right: Any) -> None:
    (HERE / name).write_bytes(data.encode() if isinstance(data, str) else data)
    rows.append({"file": name, **right, "note": note, "error": error})


def numbers(row: Sequence[float]) -> str:
    return " ".join(f"{x:g}" for x in row)


# OBJ


def obj(vertices: np.ndarray = V, faces: Sequence[Sequence[int]] = F, first: int = 1) -> str:
    lines = [f"v {numbers(v)}" for v in vertices] + [f"f {numbers([k + first for k in face])}" for face in faces]
    return "\n".join(lines) + "\n"


def interleaved() -> str:
    """Three cubes, each with faces that count back from its last vertex."""
    out = []
    for k in range(3):
        out += [f"o cube{k}", *(f"v {numbers(v + np.array([3 * k, 0, 0]))}" for v in CUBE)]
        out += [f"f {numbers([c - 8 for c in face])}" for face in CUBE_FACES]
    return "\n".join(out)


def make_obj() -> None:
    plain = obj()
    head, tail = plain.split("f ", 1)
    put("plain.obj", plain, **L_IS)
    put("relative.obj", interleaved(), volume=3, area=18, box="0 0 0 7 1 1")
    put("tabs.obj", plain.replace("v ", "v\t").replace("f 0", "f\t0").replace("f 1", "f\t1"), **L_IS)
    put(
        "indented.obj",
        "\n".join(("  " if k % 2 else "\t") * (k % 3) + x for k, x in enumerate(plain.split("\n"))),
        **L_IS,
    )
    put("comments.obj", "# made by hand\n" + plain.replace("\n", " # here\n", 12).replace("0 0 0", "0 0 0#x"), **L_IS)
    put("bom.obj", b"\xef\xbb\xbf" + plain.encode(), **L_IS)
    put("cr.obj", plain.replace("\n", "\r"), **L_IS)
    put("crlf.obj", plain.replace("\n", "\r\n"), **L_IS)
    put("continued.obj", plain.replace("f 4 2 1", "f 4 \\\n2 1"), **L_IS)
    put("upper.obj", plain.replace("v ", "V ").replace("f ", "F "), **L_IS)
    put("colours.obj", "".join(f"v {numbers(v)} 0.5 0.5 1\n" for v in V) + "f " + tail, **L_IS)
    slashes = "".join(
        "f " + " ".join(f"{k + 1}/1/1" if j else f"{k + 1}//1" for j, k in enumerate(f)) + "\n" for f in F
    )
    put("slashes.obj", f"mtllib a.mtl\n{head}vt 0 0\nvn 0 0 1\ng a b\nusemtl c\ns off\n{slashes}", **L_IS)
    for turn in range(len(L)):
        put(f"ngon-l-{turn}.obj", obj(*prism(L, turn)), **L_IS)
    for turn in range(0, len(U), 3):
        put(f"ngon-u-{turn}.obj", obj(*prism(U, turn)), **U_IS)
    # Corners on straight sides, where other faces end: every one of them must be used.
    flat = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
    put("ngon-flat-corners.obj", obj(*prism(flat)), volume=4, area=16, box="0 0 0 2 2 1")
    put("lines.obj", plain + "l 1 2\np 3\n", note="points and lines", **L_IS)
    put("unknown.obj", "frobnicate 1 2\n" + plain, note="line 1: 'frobnicate'", **L_IS)
    put("two-corners.obj", plain + "f 1 2\n", note="fewer than three corners", **L_IS)
    put("windows-folder.obj", plain.replace("f 4 2 1", "g C:\\parts\\\nf 4 2 1"), **L_IS)
    put("windows-nan.obj", plain.replace("v 4 0 0", "v 4 0 -1.#IND"), error="line 2: '-1.#IND' is no number")
    put("comment-backslash.obj", plain.replace("v 4 0 0", "v 4 0 0 # C:\\"), **L_IS)
    put("continued-blank.obj", plain.replace("f 4 2 1", "f 4 \\ \n2 1"), **L_IS)
    put("zero.obj", obj(first=0), error="line 13: index 0 is not allowed")
    put("beyond.obj", plain + "f 1 2 13\n", error="names vertex 13, but the file has 12")
    put("before-the-first.obj", plain + "f 1 2 -13\n", error="index -13 reaches back before the first of 12 vertices")
    put(
        "comma.obj",
        plain.replace("v 4 0 0", "v 4,5 0 0"),
        error="line 2: '4,5' is no number; write decimals with a point",
    )
    put("short-vertex.obj", plain.replace("v 4 1 0", "v 4 1"), error="line 3: a vertex needs three coordinates")
    put("no-number.obj", plain + "f 1 2 x\n", error="'x' is no whole number")
    put("free-form.obj", plain + "cstype bspline\n", error="'cstype' is a free-form curve or surface")
    put("points.obj", head, error="no 'f' statement, 12 vertices")
    put("huge.obj", plain.replace("v 4 ", "v 4e200 "), error="is outside 1e-30 to 1e+30")
    put("tiny.obj", obj(V * 1e-40), error="is outside 1e-30 to 1e+30")
    put("utf-16.obj", plain.encode("utf-16"), error="is UTF-16 text")
    put("zeros.obj", plain.encode() + bytes(20), error="zero byte")


# OFF


def off(head: str = "OFF", vertices: np.ndarray = V, faces: Sequence[Sequence[int]] = F, after: str = "") -> str:
    lines = [f"{head}{len(vertices)} {len(faces)} 0" if head == "" else f"{head}\n{len(vertices)} {len(faces)} 0"]
    lines += [numbers(v) for v in vertices] + [f"{len(f)} {numbers(f)}{after}" for f in faces]
    return "\n".join(lines) + "\n"


def make_off() -> None:
    plain = off()
    put("plain.off", plain, **L_IS)
    put(
        "comments.off",
        plain.replace("12 20 0", "12 20 0\n# vertices\n").replace("\n3 3 1 0", "\n\n# faces\n3 3 1 0 # a"),
        **L_IS,
    )
    put("ngon.off", off(faces=POLYGONS), **L_IS)
    put("ngon-colours.off", off(faces=POLYGONS, after=" 0.5 0.5 0.5"), **L_IS)
    put("index-colours.off", off(after=" 7"), **L_IS)
    put("lower.off", plain.replace("OFF", "off"), **L_IS)
    put("no-header.off", plain.replace("OFF\n", ""), **L_IS)
    put("one-line.off", plain.replace("OFF\n", "OFF "), **L_IS)
    put("no-space.off", plain.replace("OFF\n", "OFF"), **L_IS)
    put("4off.off", off("4OFF", np.column_stack([3 * V, np.full(12, 3)])), **L_IS)
    put("coff.off", off("COFF", np.column_stack([V, np.full((12, 4), 255)])), **L_IS)
    put("stcnoff.off", off("STCNOFF", np.column_stack([V, np.full((12, 9), 0.5)])), **L_IS)
    put("ncoff.off", off("NCOFF", np.column_stack([V, np.full((12, 7), 0.5)])), **L_IS)
    put("no-edges.off", plain.replace("12 20 0", "12 20 -1"), **L_IS)
    split = "".join(f"{x:g}\n{y:g} {z:g}\n" for x, y, z in V)
    put("two-lines-a-vertex.off", plain.replace("".join(f"{numbers(v)}\n" for v in V), split), **L_IS)
    put("cut-colours.off", off(after=" 0 0 0").rsplit("\n", 3)[0], error="is cut short: 12 vertices and 20 faces")
    put("counts-shifted.off", plain.replace("12 20 0", "13 19 0"), error="the number of vertices may be wrong")
    put("wrapped.off", plain.replace("\n", " ").replace("OFF", "OFF\n"), **L_IS)
    put("a-number-a-line.off", plain.replace(" ", "\n"), **L_IS)
    put("more.off", plain + "3 0 1 2\n", note="1 lines behind the last face", **L_IS)
    put("cut.off", plain[:-30], error="is cut short: 12 vertices and 20 faces are declared")
    put("counts.off", plain.replace("12 20 0", "12 many 0"), error="where the numbers of vertices, faces and edges")
    put("beyond.off", plain.replace("3 3 1 0", "3 3 1 12"), error="names vertex 12, but there are 12")
    put("binary.off", "OFF BINARY\n" + plain, error="is a binary OFF file")
    put("noff.off", plain.replace("OFF", "4nOFF"), error="of any number of dimensions")


# PLY

VERTEX = [(axis, "float") for axis in "xyz"]


def ply_head(layout: str, elements: Sequence[tuple[str, int, Sequence[tuple[str, str]]]], end: str = "\n") -> bytes:
    lines = ["ply", f"format {layout} 1.0", "comment made by hand"]
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *(f"property {kind} {p}" for p, kind in properties)]
    return (end.join([*lines, "end_header"]) + end).encode()


def ply(order: str = "<", faces: Sequence[Sequence[int]] = F, end: str = "\n", index: str = "vertex_indices") -> bytes:
    layout = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = ply_head(layout, [("vertex", 12, VERTEX), ("face", len(faces), [(index, "list uchar int")])], end)
    body = b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    return head + V.astype(f"{order}f4").tobytes() + body


def make_ply() -> None:
    text = "".join(f"{numbers(v)}\n" for v in V)
    head = ply_head("ascii", [("vertex", 12, VERTEX), ("face", len(POLYGONS), [("vertex_index", "list uchar int")])])
    put("ngon.ply", head + (text + "".join(f"{len(p)} {numbers(p)}\n" for p in POLYGONS)).encode(), **L_IS)
    triangular = ply_head("ascii", [("vertex", 12, VERTEX), ("face", 20, [("vertex_indices", "list uchar int")])])
    faces = "".join(f"3 {numbers(f)}\n" for f in F)
    put("ascii.ply", triangular + (text + faces).encode(), **L_IS)
    put("ascii-comma.ply", triangular + (text + faces).replace("4 1 0", "4,0 1 0").encode(), error="'4,0' is no number")
    put("ascii-cut.ply", triangular + (text + faces)[:-20].encode(), error="cut short within its 20 'face'")
    put("little.ply", ply(), **L_IS)
    put("big.ply", ply(">"), **L_IS)
    put("crlf-header.ply", ply(end="\r\n"), **L_IS)
    put("bom.ply", b"\xef\xbb\xbf" + ply(), **L_IS)
    put("mixed-ends.ply", ply().replace(b"ply\n", b"ply\r\n", 1), **L_IS)
    put("cr-header.ply", ply(end="\r"), **L_IS)
    put("mixed.ply", ply(faces=[*F[:8], *POLYGONS[2:]]), **L_IS)
    put("mixed-big.ply", ply(">", faces=POLYGONS), **L_IS)
    put("newline-behind.ply", ply() + b"\n", **L_IS)
    put("bytes-behind.ply", ply() + b"what is this", note="12 bytes behind the last element", **L_IS)
    put("cut.ply", ply()[:-30], error="cut short within its 20 'face'")
    put("beyond.ply", ply(faces=[*F[:-1], [0, 1, 12]]), error="face 19: names vertex 12, but there are 12")
    put("fractional.ply", triangular + (text + faces).replace("3 3 1 0", "3 3 1 0.5").encode(), error="not whole")
    tetrahedron = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    strips = [1, 2, 3, 0, -1, 2, 1, 0, 3]
    head = ply_head("ascii", [("vertex", 4, VERTEX), ("tristrips", 1, [("vertex_indices", "list int int")])])
    body = "".join(f"{numbers(v)}\n" for v in tetrahedron) + f"{len(strips)} {numbers(strips)}\n"
    put("strips.ply", head + body.encode(), volume=1 / 6, area=1.5 + np.sqrt(3) / 2, box="0 0 0 1 1 1")
    corners = [("flags", "uchar"), ("vertex_indices", "list ushort uint"), ("uv", "list uchar float")]
    coloured = [("x", "double"), ("red", "uchar"), ("y", "double"), ("z", "double")]
    rich = [("vertex", 12, coloured), ("edge", 1, [("a", "int"), ("b", "int")]), ("face", 20, corners)]
    body = b"".join(struct.pack("<dBdd", x, 9, y, z) for x, y, z in V) + struct.pack("<2i", 0, 1)
    body += b"".join(struct.pack(f"<BH3IB{k % 3}f", 1, 3, *f, k % 3, *[0.5] * (k % 3)) for k, f in enumerate(F))
    put("rich.ply", ply_head("binary_little_endian", rich) + body, note="'edge', 1 of them, was not read", **L_IS)
    head = ply_head(
        "binary_little_endian", [("vertex", 12, VERTEX), ("quads", 1, [("vertex_indices", "list uchar int")])]
    )
    put(
        "other-faces.ply",
        head + V.astype("<f4").tobytes() + struct.pack("<B4i", 4, 0, 1, 2, 3),
        error="'quads' names vertices",
    )
    put(
        "points.ply",
        ply_head("binary_little_endian", [("vertex", 12, VERTEX)]) + V.astype("<f4").tobytes(),
        error="point cloud",
    )
    put("no-z.ply", ply().replace(b"property float z", b"property float w"), error="no property 'z'")
    put("header-cut.ply", ply()[:60], error="no line 'end_header'")


# STL


def stl_ascii(name: str = "part", ends: int = 1, solids: int = 1) -> str:
    out = []
    for k in range(solids):
        out.append(f"solid {name}")
        for face in F:
            out += [
                "  facet normal 0 0 0",
                "    outer loop",
                *(f"      vertex {numbers(V[c] + [5 * k, 0, 0])}" for c in face),
            ]
            out += ["    endloop", "  endfacet"]
        if k < ends:
            out.append(f"endsolid {name}")
    return "\n".join(out) + "\n"


def stl_binary(count: int = 20, header: bytes = b"") -> bytes:
    out = header.ljust(80, b"\0") + struct.pack("<I", count)
    return out + b"".join(struct.pack("<12fH", 0, 0, 0, *V[f].ravel(), 0) for f in F)


def make_stl() -> None:
    put("ascii.stl", stl_ascii(), **L_IS)
    put("name-vertex.stl", stl_ascii("vertex cap facet normal 2"), **L_IS)
    put("name-endsolid.stl", stl_ascii(r"C:\parts\endsolid bendsolid.prt"), **L_IS)
    put("no-name.stl", stl_ascii("").replace("solid \n", "solid\n"), **L_IS)
    put("upper.stl", stl_ascii().upper(), **L_IS)
    put("one-line.stl", stl_ascii().replace("\n", " ").replace("solid part", "solid part\n", 1), **L_IS)
    put("two-solids.stl", stl_ascii(ends=2, solids=2), volume=12, area=52, box="0 0 0 9 3 1")
    put("no-endsolid.stl", stl_ascii(ends=0), note="no line 'endsolid'", **L_IS)
    put("last-solid-cut.stl", stl_ascii(ends=1, solids=2), error="cut short: its last solid has no line 'endsolid'")
    put("facet-cut.stl", stl_ascii()[:-60], error="cut short within a facet")
    put("four-corners.stl", stl_ascii().replace("endloop", "vertex 0 0 0\n endloop", 1), error="line 2: a facet is")
    put("comma.stl", stl_ascii().replace("4 1 0", "4,0 1 0"), error="'4,0' is no number")
    put("binary.stl", stl_binary(), **L_IS)
    put("binary-solid.stl", stl_binary(header=b"solid facet normal"), **L_IS)
    put("solid-tail.stl", stl_binary(header=b"solid part") + b"tail", note="4 bytes behind them", **L_IS)
    put(
        "solid-cut.stl",
        stl_binary(header=b"solid part")[:-30],
        error="the header says 20 triangles, the file has room for 19",
    )
    put("ctrl-z.stl", stl_ascii() + "\x1a", **L_IS)
    put("comment.stl", "# made by hand\n" + stl_ascii(), error="line 1: '#' where 'solid' should stand")
    put("tail.stl", stl_binary() + b"tail", note="4 bytes behind them", **L_IS)
    put("count-0.stl", stl_binary(0), error="the header says 0 triangles, the file has room for 20")
    put("count-too-large.stl", stl_binary(21), error="the header says 21 triangles, the file has room for 20")
    put("short.stl", b"x" * 40, error="has 40 bytes")


# glTF


class Gltf:
    """A document that accessors, meshes and nodes are added to."""

    def __init__(self) -> None:
        self.data = b""
        self.root: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}

    def add(self, kind: str, **item: Any) -> int:
        self.root.setdefault(kind, []).append(item)
        return len(self.root[kind]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        start = len(self.data)
        self.data += data + bytes(-len(data) % 4)
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(data), **more)

    def accessor(self, array: np.ndarray, **more: Any) -> int:
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        types = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
        width = 1 if array.ndim == 1 else array.shape[1]
        # glTF wants rows of vertices to begin at multiples of four bytes.
        row = array.itemsize * width
        stride = row + -row % 4 if array.ndim > 1 else row
        packed = b"".join(r.tobytes() + bytes(stride - row) for r in array)
        view = self.view(packed, **({"byteStride": stride} if stride > row else {}))
        kind = kinds[array.dtype.str[1:]]
        span = {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()} if width == 3 else {}
        return self.add(
            "accessors", bufferView=view, componentType=kind, count=len(array), type=types[width], **{**span, **more}
        )

    def mesh(self, positions: int, faces: Sequence[Sequence[int]] | None = F, **more: Any) -> int:
        mesh = more.pop("mesh", {})
        primitive = {"attributes": {"POSITION": positions, **more.pop("attributes", {})}, **more}
        if faces is not None:
            primitive["indices"] = self.accessor(np.array(faces, dtype="<u2").ravel())
        return self.add("meshes", primitives=[primitive], **mesh)

    def node(self, shown: bool = True, **item: Any) -> int:
        node = self.add("nodes", **item)
        if shown:
            self.root["scenes"][0]["nodes"].append(node)
        return node

    def require(self, *names: str) -> None:
        self.root["extensionsUsed"] = self.root["extensionsRequired"] = list(names)

    def glb(self) -> bytes:
        self.root["buffers"] = [{"byteLength": len(self.data)}, *self.root.get("buffers", [])[1:]]
        text = json.dumps(self.root).encode()
        text += b" " * (-len(text) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.data), b"BIN\0") + self.data
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def gltf(self, uri: str) -> str:
        self.root["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        return json.dumps(self.root, indent=1)


def one(**node: Any) -> Gltf:
    out = Gltf()
    out.node(mesh=out.mesh(out.accessor(V.astype("<f4"))), **node)
    return out


def make_glb() -> None:
    put("plain.glb", one().glb(), **L_IS)
    put(
        "matrix.glb",
        one(matrix=[2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 5, 6, 7, 1]).glb(),
        volume=48,
        area=104,
        box="5 6 7 13 12 9",
    )
    put("mirror.glb", one(scale=[-1, 1, 1]).glb(), volume=6, area=26, box="-4 0 0 0 3 1")
    half = np.sqrt(0.5)
    g = one(translation=[10, 0, 0])
    g.root["nodes"] = [{"children": [1], "rotation": [0, 0, half, half]}, *g.root["nodes"]]  # a quarter turn about z
    g.root["scenes"] = [{"nodes": [0]}]
    put("nested.glb", g.glb(), volume=6, area=26, box="-3 10 0 0 14 1")
    g = Gltf()
    g.require("KHR_mesh_quantization")
    quantised = np.rint((V / 2 - 1) * 32767).astype("<i2")  # -1 to 1 for 0 to 4
    g.node(mesh=g.mesh(g.accessor(quantised, normalized=True)), scale=[2, 2, 2], translation=[2, 2, 2])
    put("normalised.glb", g.glb(), **L_IS)
    g = Gltf()
    g.require("KHR_mesh_quantization")
    g.node(mesh=g.mesh(g.accessor((V * 50).astype("<u1"))), scale=[0.02] * 3)
    put("quantised.glb", g.glb(), **L_IS)
    g = Gltf()
    g.require("EXT_mesh_gpu_instancing")
    places = np.array([(0, 0, 0), (10, 0, 0), (0, 10, 0)], dtype="<f4")
    sizes = np.array([(1, 1, 1), (2, 2, 2), (1, 1, 1)], dtype="<f4")
    instances = {"attributes": {"TRANSLATION": g.accessor(places), "SCALE": g.accessor(sizes)}}
    g.node(mesh=g.mesh(g.accessor(V.astype("<f4"))), extensions={"EXT_mesh_gpu_instancing": instances})
    put("instances.glb", g.glb(), volume=60, area=156, box="0 0 0 18 13 2")
    g = Gltf()
    at, lifted = np.arange(6, 12, dtype="<u2"), (V[6:] + np.array([0, 0, 1])).astype("<f4")
    sparse = {"count": 6, "indices": {"bufferView": g.view(at.tobytes()), "componentType": 5123},
              "values": {"bufferView": g.view(lifted.tobytes())}}  # fmt: skip
    g.node(mesh=g.mesh(g.accessor(V.astype("<f4"), sparse=sparse, max=[4, 3, 2])))
    put("sparse.glb", g.glb(), volume=12, area=40, box="0 0 0 4 3 2")
    g = Gltf()
    fan = np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (1, 0, 0)], dtype="<f4")
    base = np.array([(0, 0, 0), (0, -1, 0), (-1, 0, 0), (0, 1, 0), (1, 0, 0), (0, -1, 0)], dtype="<f4")
    g.node(mesh=g.mesh(g.accessor(fan), None, mode=6))
    g.node(mesh=g.mesh(g.accessor(base), None, mode=6))
    put("fans.glb", g.glb(), volume=2 / 3, area=2 + 2 * np.sqrt(3), box="-1 -1 0 1 1 1")
    g = Gltf()
    strip = np.array([1, 0, 5, 4, 6, 0, 2, 1, 3, 5, 7, 6, 3, 2], dtype="<u1")  # round a cube
    mesh = g.mesh(g.accessor(CUBE.astype("<f4")), None, mode=5)
    g.root["meshes"][mesh]["primitives"][0]["indices"] = g.accessor(strip)
    g.node(mesh=mesh)
    put("strip.glb", g.glb(), **BOX_IS)
    g = Gltf()
    higher = np.where(V[:, 2:] > 0, [0, 0, 2], [0, 0, 0]).astype("<f4")
    target = [{"POSITION": g.accessor(higher)}]
    g.node(mesh=g.mesh(g.accessor(V.astype("<f4")), targets=target, mesh={"weights": [0.5]}))
    put("morph.glb", g.glb(), volume=12, area=40, box="0 0 0 4 3 2")
    g = Gltf()
    bones = {"JOINTS_0": g.accessor(np.tile(np.array([0, 1, 0, 0], dtype="u1"), (12, 1))),
             "WEIGHTS_0": g.accessor(np.tile(np.array([0.25, 0.75, 0, 0], dtype="<f4"), (12, 1)))}  # fmt: skip
    binds = np.tile(np.eye(4, dtype="<f4").ravel(), (2, 1))
    binds[:, 12] = 1  # column-major: a shift along x
    g.node(mesh=g.mesh(g.accessor(V.astype("<f4")), attributes=bones), skin=0, translation=[50, 0, 0])
    g.node(translation=[4, 0, 0])
    g.node(translation=[8, 0, 0])
    g.add("skins", joints=[1, 2], inverseBindMatrices=g.accessor(binds))
    put("skin.glb", g.glb(), volume=6, area=26, box="8 0 0 12 3 1")
    g.root["nodes"].append({"children": [0, 1, 2], "scale": [-1, 1, 1]})
    g.root["scenes"] = [{"nodes": [3]}]
    put("skin-mirrored.glb", g.glb(), volume=6, area=26, box="-12 0 0 -8 3 1")
    g = one()
    g.root["scenes"].append({"nodes": []})
    put("two-scenes.glb", g.glb(), note="scene 0 of 2 was read", **L_IS)
    g = one()
    g.node(mesh=0, translation=[9, 0, 0], extensions={"KHR_node_visibility": {"visible": False}})
    put("hidden.glb", g.glb(), note="1 hidden nodes", **L_IS)
    g = one()
    g.node(shown=False, mesh=0, translation=[9, 0, 0])
    put("not-in-the-scene.glb", g.glb(), note="not part of the scene", **L_IS)
    g = one()
    g.root["accessors"][0]["max"] = [40, 3, 1]
    put("wrong-range.glb", g.glb(), note="max is declared as (40, 3, 1), its data has (4, 3, 1)", **L_IS)
    g = one()
    g.root["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})
    put("lines.glb", g.glb(), note="points or lines", **L_IS)
    g = one()
    g.require("EXT_frobnicated_mesh")
    put("unknown-extension.glb", g.glb(), error="requires the glTF extension 'EXT_frobnicated_mesh'")
    g = one()
    g.root["extensionsUsed"] = g.root["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    put("materials.glb", g.glb(), **L_IS)
    put("cut.glb", one().glb()[:-40], error="is cut short: the header declares")
    g = one()
    g.root["accessors"][1]["count"] = 63
    put("accessor-too-long.glb", g.glb(), error="reach beyond the")
    g = one()
    g.root["nodes"].append({"children": [1]})
    put("circle.glb", g.glb(), error="is its own ancestor")
    g = one()
    g.root["nodes"] += [{"children": [2, 0]}, {"children": [1]}]  # the circle is entered from the node with the mesh
    put("circle-from-outside.glb", g.glb(), error="is its own ancestor")
    g = Gltf()
    g.node(mesh=g.mesh(g.accessor(V.astype("<f4")), [[0, 1, 12]]))
    put("beyond.glb", g.glb(), error="names vertex 12, but there are 12")
    put("version-1.glb", struct.pack("<4sIII", b"glTF", 1, 24, 4).ljust(24, b" "), error="version 1")
    g = one()
    (HERE / "l.bin").write_bytes(g.data)
    put("beside.gltf", g.gltf("l.bin"), **L_IS)
    put("escaped.gltf", g.gltf("%6c.bin"), **L_IS)
    put("inside.gltf", g.gltf("data:application/octet-stream;base64," + base64.b64encode(g.data).decode()), **L_IS)
    put("missing.gltf", g.gltf("gone.bin"), error="names 'gone.bin', which cannot be read beside it")
    put("elsewhere.gltf", g.gltf("../conftest.py"), error="not in its own folder")
    put("web.gltf", g.gltf("https://example.org/l.bin"), error="not in its own folder")


def make_compressed_glb() -> None:
    """Make files with bytes that the two libraries wrote once: other versions write other bytes."""
    import DracoPy
    import meshoptimizer

    g = Gltf()
    g.require("KHR_draco_mesh_compression")
    packed = g.view(DracoPy.encode(V.astype(np.float32), np.array(F, dtype=np.uint32), quantization_bits=14))
    positions = g.add("accessors", componentType=5126, count=12, type="VEC3")
    mesh = g.mesh(
        positions,
        None,
        extensions={"KHR_draco_mesh_compression": {"bufferView": packed, "attributes": {"POSITION": 0}}},
    )
    g.root["meshes"][mesh]["primitives"][0]["indices"] = g.add("accessors", componentType=5125, count=60, type="SCALAR")
    g.node(mesh=mesh)
    put("draco.glb", g.glb(), **L_IS)
    g.root["accessors"][0]["count"] = 13
    put("draco-count.glb", g.glb(), error="declares 13 positions, its Draco data has 12")
    g = Gltf()
    g.require("EXT_meshopt_compression")
    g.root["buffers"] = [{}, {"byteLength": 264, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
    points = bytes(meshoptimizer.encode_vertex_buffer(V.astype(np.float32), 12, 12))
    faces = bytes(meshoptimizer.encode_index_buffer(np.array(F, dtype=np.uint32).ravel(), 60, 12))
    for mode, stride, count, data in (("ATTRIBUTES", 12, 12, points), ("TRIANGLES", 2, 60, faces)):
        place = {"buffer": 0, "byteOffset": len(g.data), "byteLength": len(data)}
        g.data += data + bytes(-len(data) % 4)
        compressed = {**place, "byteStride": stride, "count": count, "mode": mode}
        g.add("bufferViews", buffer=1, byteLength=stride * count, extensions={"EXT_meshopt_compression": compressed})
    g.add("accessors", bufferView=0, componentType=5126, count=12, type="VEC3")
    g.add("accessors", bufferView=1, componentType=5123, count=60, type="SCALAR")
    g.add("meshes", primitives=[{"attributes": {"POSITION": 0}, "indices": 1}])
    g.node(mesh=0)
    put("meshopt.glb", g.glb(), **L_IS)


# 3MF


def threemf(resources: str, build: str, extensions: str = "", root: str = "3D/3dmodel.model") -> bytes:
    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    head = f'<?xml version="1.0"?>\n<model unit="millimeter" xmlns="{core}" {extensions}>'
    text = f"{head}<resources>{resources}</resources>"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        if "my" in root:  # only the package's relationships tell that this is the model
            archive.writestr(zipfile.ZipInfo("3D/1.model"), f"{text}</model>")
            kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
            relation = f'<Relationship Target="/{root}" Id="rel0" Type="{kind}"/>'
            archive.writestr(zipfile.ZipInfo("_rels/.rels"), f"<Relationships>{relation}</Relationships>")
        archive.writestr(zipfile.ZipInfo(root), f"{text}<build>{build}</build></model>", zipfile.ZIP_DEFLATED)
    return out.getvalue()


def make_3mf() -> None:
    vertices = "".join('<vertex x="{:g}" y="{:g}" z="{:g}"/>'.format(*v) for v in V)
    faces = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*f) for f in F)
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"
    part = f'<object id="1" type="model">{mesh}</object>'
    put("plain.3mf", threemf(part, '<item objectid="1"/>'), **L_IS)
    both = '<component objectid="1"/><component objectid="1" transform="-1 0 0 0 1 0 0 0 1 -1 0 0"/>'
    assembly = f'{part}<object id="2"><components>{both}</components></object>'
    item = '<item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 10"/>'
    put("components.3mf", threemf(assembly, item), volume=96, area=208, box="-10 0 10 8 6 12")
    support = f'{part}<object id="2" type="support">{mesh}</object>'
    items = '<item objectid="1"/><item objectid="2" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>'
    put("support.3mf", threemf(support, items), note="supports", **L_IS)
    both = '<component objectid="1"/><component objectid="2"/>'
    modifier = support.replace("support", "other") + f'<object id="3"><components>{both}</components></object>'
    put(
        "modifier.3mf",
        threemf(modifier, '<item objectid="3"/>'),
        note="1 objects that are supports or no parts",
        **L_IS,
    )
    solid = support.replace("support", "solidsupport")
    put("solidsupport.3mf", threemf(solid, items), note="supports", **L_IS)
    put("other-root.3mf", threemf(part, '<item objectid="1"/>', root="3D/my.model"), **L_IS)
    put("lower-case.3mf", threemf(part, '<item objectid="1"/>', root="3d/3dmodel.model"), **L_IS)
    put("gone.3mf", threemf(part, '<item objectid="7"/>'), error="names the object '7'")
    put("circle.3mf", threemf('<object id="1"><components><component objectid="1"/></components></object>',
        '<item objectid="1"/>'), error="within themselves")  # fmt: skip
    put("beyond.3mf", threemf(part.replace('v1="3"', 'v1="12"', 1), '<item objectid="1"/>'), error="names vertex 12")
    lattice = 'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" requiredextensions="b"'
    put("lattice.3mf", threemf(part, '<item objectid="1"/>', lattice), error="beamlattice")
    put("cut.3mf", threemf(part, '<item objectid="1"/>')[:-40], error="damaged")


# What a name does not tell.


def make_others() -> None:
    put("l.obj.gz", gzip.compress(obj().encode(), mtime=0), **L_IS)
    put("l.ply.bz2", bz2.compress(ply()), **L_IS)
    put("l.stl.xz", lzma.compress(stl_binary()), **L_IS)
    put("l.off.zst", zstandard.ZstdCompressor().compress(off().encode()), **L_IS)
    frames = [zstandard.ZstdCompressor().compress(half) for half in (off().encode()[:99], off().encode()[99:])]
    put("two-frames.off.zst", b"".join(frames), **L_IS)
    put("twice.obj.gz", gzip.compress(gzip.compress(obj().encode(), mtime=0), mtime=0), error="is compressed twice")
    put("cut.ply.gz", gzip.compress(ply(), mtime=0)[:-20], error="(.gz) is damaged or cut short")
    put("cut.ply.zst", zstandard.ZstdCompressor().compress(ply())[:-20], error="(.zst) is damaged or cut short")
    put("ply-inside.obj", ply(), note="the content is PLY, whatever the name says", **L_IS)
    put("obj-inside.stl", obj(), note="the content is OBJ, whatever the name says", **L_IS)
    put("glb-inside.gltf", one().glb(), note="the content is GLB", **L_IS)
    put("empty.stl", b"", error="is empty")
    put("blank.obj", "\n \n", error="nothing but white space")
    put("page.obj", "<!DOCTYPE html>\n<html><body>Not found</body></html>", error="is a web page, not a mesh")
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 12345\n"
    put("pointer.ply", pointer, error="is a Git LFS pointer, not the mesh itself: run: git lfs pull")
    put("picture.obj", b"\x89PNG\r\n\x1a\n" + bytes(30), error="is a PNG picture")
    put("step.obj", "ISO-10303-21;\nHEADER;\n", error="is a STEP file")
    put("collada.obj", '<?xml version="1.0"?>\n<COLLADA version="1.4.1"/>', error="is a COLLADA file")
    put("fbx.glb", b"Kaydara FBX Binary  \0\x1a\0" + bytes(20), error="is an FBX file")
    put("archive.stl", b"PK\x03\x04" + bytes(26), error="is a ZIP archive: unpack it")
    put("words.off", "Dear reader,\nthis is no mesh.\n", error="line 1: 'Dear reader,' where the numbers")


def main() -> None:
    for make in (make_obj, make_off, make_ply, make_stl, make_glb, make_compressed_glb, make_3mf, make_others):
        make()
    with open(HERE / "index.tsv", "w", newline="") as file:
        columns = ["file", "volume", "area", "box", "note", "error"]
        writer = csv.DictWriter(
            file, columns, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_NONE, quotechar=None
        )
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.9g}" if isinstance(v, float) else v for k, v in row.items()})


if __name__ == "__main__":
    main()
