"""Recognise a file by its first bytes: as a format that is read, or as one that is not, with the remedy."""

from __future__ import annotations

import re

from . import stl, threemf
from .common import UnreadableError

# First bytes of formats that are not read, their names, and what to do.
CONVERT = "convert it to GLB, OBJ, PLY or STL"
FOREIGN: list[tuple[bytes, str, str]] = [
    (b"version https://git-lfs.github.com", "a Git LFS pointer, not the mesh itself", "run: git lfs pull"),
    (b"ISO-10303-21", "a STEP file", "tessellate it in a CAD program and save STL or 3MF"),
    (b"Kaydara FBX Binary", "an FBX file", CONVERT),
    (b"; FBX", "an FBX file", CONVERT),
    (b"BLENDER", "a Blender file", "export GLB from Blender"),
    (b"DRACO", "a bare Draco file", CONVERT),
    (b"\x89DHF", "a .cndhf file already", "cndhf-decode makes a mesh of it"),
    (b"PXR-USDC", "a USD file", CONVERT),
    (b"#usda", "a USD file", CONVERT),
    (b"#VRML", "a VRML file", CONVERT),
    (b"# vtk DataFile", "a VTK file", CONVERT),
    (b"$MeshFormat", "a Gmsh file", CONVERT),
    (b"3D Geometry File Format", "a Rhino file", CONVERT),
    (b"FORM", "an IFF file, such as LightWave's", CONVERT),
    (b"MM", "a 3D Studio or TIFF file", CONVERT),
    (b"\x89PNG", "a PNG picture", "name a mesh file"),
    (b"\xff\xd8\xff", "a JPEG picture", "name a mesh file"),
    (b"GIF8", "a GIF picture", "name a mesh file"),
    (b"%PDF", "a PDF document", "name a mesh file"),
    (b"\x7fELF", "a program", "name a mesh file"),
    (b"Rar!", "an archive", "unpack it"),
    (b"7z\xbc\xaf\x27\x1c", "an archive", "unpack it"),
    (b"PK", "a ZIP archive", "unpack it"),
    (b"\x93NUMPY", "a NumPy array", "pass (vertices, faces) from Python"),
    (b"\x89HDF", "an HDF5 file", CONVERT),
]
XML = [  # root elements
    ("collada", "a COLLADA file", CONVERT),
    ("x3d", "an X3D file", CONVERT),
    ("amf", "an AMF file", CONVERT),
    ("vtkfile", "a VTK file", CONVERT),
    ("html", "a web page, not a mesh", "download the file itself"),
    ("svg", "a drawing", "name a mesh file"),
]
OBJ_STATEMENT = re.compile(rb"(?:v|vn|vt|f|o|g|s|mtllib|usemtl)(?=[ \t])", re.IGNORECASE)
LOOKED_AT = 2**16  # first bytes within which a text's nature must show
BOM = b"\xef\xbb\xbf"


def check_foreign(data: bytes) -> None:
    """Raise UnreadableError when there are no bytes, or bytes of a kind that is not read."""
    if not data.strip():
        raise UnreadableError("is empty" if not data else "holds nothing but white space")
    start = data[:LOOKED_AT].removeprefix(BOM).lstrip()
    for magic, name, remedy in FOREIGN:
        if start.startswith(magic):
            raise UnreadableError(f"is {name}: {remedy}")
    if start.startswith(b"<"):
        text = start.lower()
        for root, name, remedy in XML:
            if re.search(rf"<(?:!doctype\s+)?(?:\w+:)?{root}\b".encode(), text):
                raise UnreadableError(f"is {name}: {remedy}")
    if data[257:262] == b"ustar":
        raise UnreadableError("is a tar archive: unpack it")


def recognise(data: bytes) -> str | None:
    """Name the format of the bytes: "ply", "glb", "gltf", "3mf", "stl" or "off" beyond doubt; "obj" where the first
    statement is one of OBJ's; else None."""
    if stl.is_binary(data):
        return "stl"
    if data.startswith(b"glTF"):
        return "glb"
    if re.match(rb"(?:\xef\xbb\xbf)?ply[ \t]*[\r\n]", data):
        return "ply"
    if threemf.is_3mf(data):
        return "3mf"
    if stl.is_ascii(data):
        return "stl"
    text = data[:LOOKED_AT].removeprefix(BOM).lstrip()
    if b"\0" in text:
        return None
    if text.startswith(b"{") and b'"asset"' in data:
        return "gltf"
    for line in re.split(rb"[\r\n]+", text):
        line = line.strip()
        if line and not line.startswith(b"#"):
            if re.match(rb"(?:ST|[CNn4])*OFF(?![A-Za-z])", line, re.IGNORECASE):
                return "off"
            return "obj" if OBJ_STATEMENT.match(line) else None
    return None
