"""Binary glTF files (GLB) of one mesh, which may carry a `.cndhf` file: the extension `CNDHF_shape` of spec/gltf.md.

Our own writer, since trimesh's has no place for such a file.
"""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

import numpy.typing as npt

from ..arrays import F64, I64

EXTENSION = "CNDHF_shape"
FLOAT, UNSIGNED_INT = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


class Embedded(NamedTuple):
    """The bytes of a `.cndhf` file for a GLB to carry, and whether the mesh is written, too, for other readers."""

    file: bytes
    fallback: bool = True


def glb_bytes(
    vertices: F64, faces: I64, normals: npt.NDArray[Any] | None, origin: F64, embedded: Embedded | None
) -> bytes:
    """The bytes of a GLB.

    Parameters
    ----------
    vertices : ndarray, shape (N, 3)
        Positions.
    faces : ndarray, shape (M, 3)
        Corners of triangles.
    normals : ndarray, shape (N, 3), or None
        Unit normals of vertices.
    origin : ndarray, shape (3,)
        What is taken from positions before they become float32. Unless it is zero, the node moves the mesh back.
    embedded : Embedded or None
        Without a fallback, only the box of the mesh is written.
    """
    with_mesh = embedded is None or embedded.fallback
    body = bytearray()
    views: list[dict[str, int]] = []

    def view(data: bytes, **target: int) -> int:
        """Append to the binary chunk, at a multiple of 4 bytes; the number of its buffer view."""
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data), **target})
        body.extend(data + bytes(-len(data) % 4))
        return len(views) - 1

    def accessor(array: npt.NDArray[Any], target: int, **rest: object) -> dict[str, object]:
        if not with_mesh:
            return {"count": 3, **rest}  # as many as a triangle has
        return {"bufferView": view(array.tobytes(), target=target), "count": len(array), **rest}

    positions = (vertices - origin).astype("<f4")
    box = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    of_vertices = {"componentType": FLOAT, "type": "VEC3"}
    accessors = [accessor(positions, ARRAY_BUFFER, **of_vertices, **box)]
    primitive: dict[str, object] = {"attributes": {"POSITION": 0}, "material": 0}
    if with_mesh:
        corners = faces.astype("<u4").reshape(-1)
        accessors.append(accessor(corners, ELEMENT_ARRAY_BUFFER, componentType=UNSIGNED_INT, type="SCALAR"))
        primitive["indices"] = 1
    if with_mesh and normals is not None:
        accessors.append(accessor(normals.astype("<f4"), ARRAY_BUFFER, **of_vertices))
        primitive["attributes"] = {"POSITION": 0, "NORMAL": 2}
    place = origin.tolist() if origin.any() else None
    if embedded is not None:
        shape = {"bufferView": view(embedded.file), **({"origin": place} if place else {})}
        primitive["extensions"] = {EXTENSION: shape}
    root = {
        "asset": {"version": "2.0", "generator": "cndhf-codec"},
        **({} if embedded is None else {"extensionsUsed": [EXTENSION]}),
        **({} if with_mesh else {"extensionsRequired": [EXTENSION]}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **({"translation": place} if place else {})}],
        "meshes": [{"primitives": [primitive]}],
        # glTF's own default is metal, which is black where nothing is mirrored in it.
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.7}}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    text = json.dumps(root, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(body), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(body), 0x004E4942) + body
