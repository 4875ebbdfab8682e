"""Mesh files out, through trimesh where it keeps the precision of the coordinates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import F64, I64
from ..errors import OptionError, require
from ..files import write_atomically

WITH_NORMALS = {"ply": "vertex_normal", "obj": "include_normals", "glb": "include_normals"}  # trimesh's options
EXTENSIONS = (".ply", ".obj", ".stl", ".off", ".glb")
FINE = 1e-6  # of the mesh's size: rounding that no one will miss


def check_extension(path: str | os.PathLike[str]) -> str:
    """The format that a path's extension names, in lower case. Raises OptionError for one not written."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXTENSIONS:
        raise OptionError(f"{Path(path)}: unknown mesh extension; these are written: {', '.join(EXTENSIONS)}")
    return suffix[1:]


def check_normals(path: str | os.PathLike[str]) -> None:
    """Raises OptionError when the format of a path's extension holds no vertex normals."""
    if check_extension(path) not in WITH_NORMALS:
        raise OptionError(f"{Path(path)}: this format holds no vertex normals; .ply, .obj and .glb do")


def mesh_bytes(mesh: Any, extension: str, with_normals: bool = False) -> tuple[bytes, str | None]:
    """The bytes of a mesh file, and a line of warning where the format cannot keep the precision: STL, float32.

    extension: one of `EXTENSIONS` without its dot. Far from the origin, where float32 would round the coordinates by
    more than a millionth of the mesh's size, a PLY holds float64 and a GLB moves its mesh by a node's transform.
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    normals = np.asarray(mesh.vertex_normals) if with_normals else None
    size = float(np.ptp(vertices, axis=0).max())
    rounding = float(np.spacing(np.float32(np.abs(vertices).max())) / 2)
    coarse = rounding > FINE * size
    if extension == "obj":
        return _obj(vertices, faces, normals), None
    if extension == "off":
        return _off(vertices, faces), None
    if extension == "ply" and coarse:
        return _double_ply(vertices, faces, normals), None
    if extension == "glb" and coarse:
        return _moved_glb(vertices, faces, normals), None
    options = {WITH_NORMALS[extension]: with_normals} if extension in WITH_NORMALS else {}
    data = mesh.export(file_type=extension, **options)
    if not coarse:
        return data, None
    return data, (
        f"STL holds float32: so far from the origin positions are rounded by {rounding:.2g}; "
        "write .ply, .obj, .off or .glb to keep them"
    )


def write_mesh(
    mesh: Any, path: str | os.PathLike[str], overwrite: bool = False, with_normals: bool = False
) -> str | None:
    """Write a `trimesh.Trimesh`, whole or not at all; with_normals: and its vertex normals.

    Returns the warning of `mesh_bytes`, after the path. Raises OptionError or OutputError.
    """
    extension = check_extension(path)
    if with_normals:
        check_normals(path)
    data, warning = mesh_bytes(mesh, extension, with_normals)
    write_atomically(path, data, overwrite)
    return None if warning is None else f"{Path(path)}: {warning}"


def _obj(vertices: F64, faces: I64, normals: F64 | None) -> bytes:
    if normals is None:
        return f"{_coordinates('v ', vertices)}{_numbers('f', faces + 1)}".encode()
    directions = "".join([f"vn {x:.6g} {y:.6g} {z:.6g}\n" for x, y, z in normals.tolist()])
    corners = "".join([f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in (faces + 1).tolist()])
    return f"{_coordinates('v ', vertices)}{directions}{corners}".encode()


def _off(vertices: F64, faces: I64) -> bytes:
    head = f"OFF\n{len(vertices)} {len(faces)} 0\n"
    return f"{head}{_coordinates('', vertices)}{_numbers('3', faces)}".encode()


def _coordinates(start: str, vertices: F64) -> str:
    """Lines with as many digits as a float32 has at the origin, and more far from it."""
    far = np.log10(np.abs(vertices).max() / np.ptp(vertices, axis=0).max())
    digits = min(9 + max(0, int(np.ceil(far))), 17)
    return "".join([f"{start}{x:.{digits}g} {y:.{digits}g} {z:.{digits}g}\n" for x, y, z in vertices.tolist()])


def _numbers(start: str, faces: I64) -> str:
    return "".join([f"{start} {a} {b} {c}\n" for a, b, c in faces.tolist()])


def _double_ply(vertices: F64, faces: I64, normals: F64 | None) -> bytes:
    names = ["x", "y", "z"] if normals is None else ["x", "y", "z", "nx", "ny", "nz"]
    columns = vertices if normals is None else np.hstack([vertices, normals])
    properties = "".join(f"property double {name}\n" for name in names)
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    return head.encode() + columns.astype("<f8").tobytes() + records.tobytes()


def _moved_glb(vertices: F64, faces: I64, normals: F64 | None) -> bytes:
    trimesh = require("trimesh", "mesh")
    middle = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
    scene = trimesh.Scene()
    at = np.eye(4)
    at[:3, 3] = middle
    moved = trimesh.Trimesh(vertices - middle, faces, vertex_normals=normals, process=False)
    scene.add_geometry(moved, transform=at)
    return scene.export(file_type="glb", include_normals=normals is not None)
