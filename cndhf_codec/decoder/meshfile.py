"""Mesh files out, through trimesh where it keeps the precision of the coordinates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import OptionError, require
from ..files import write_atomically

EXTENSIONS = (".ply", ".obj", ".stl", ".off", ".glb")
FINE = 1e-6  # of the mesh's size: rounding that no one will miss


def check_extension(path: str | os.PathLike[str]) -> str:
    """The format that a path's extension names, in lower case. Raises OptionError for one not written."""
    suffix = Path(path).suffix.lower()
    if suffix not in EXTENSIONS:
        raise OptionError(f"{Path(path)}: unknown mesh extension; these are written: {', '.join(EXTENSIONS)}")
    return suffix[1:]


def write_mesh(mesh: Any, path: str | os.PathLike[str], overwrite: bool = False) -> str | None:
    """Write a `trimesh.Trimesh`, whole or not at all. Raises OptionError or OutputError.

    Far from the origin, where float32 would round the coordinates by more than a millionth of the mesh's size, a PLY
    holds float64 and a GLB moves its mesh by a node's transform. Returns a line of warning where a format cannot keep
    the precision: STL, which is float32.
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    extension = check_extension(path)
    size = float(np.ptp(vertices, axis=0).max())
    rounding = float(np.spacing(np.float32(np.abs(vertices).max())) / 2)
    coarse = rounding > FINE * size
    warning = None
    if extension == "obj":
        data = _obj(vertices, faces)
    elif extension == "off":
        data = _off(vertices, faces)
    elif extension == "ply" and coarse:
        data = _double_ply(vertices, faces)
    elif extension == "glb" and coarse:
        data = _moved_glb(vertices, faces)
    else:
        data = mesh.export(file_type=extension)
        if coarse:
            warning = (
                f"{Path(path)}: STL holds float32: so far from the origin positions are rounded by {rounding:.2g}; "
                "write .ply, .obj, .off or .glb to keep them"
            )
    write_atomically(path, data, overwrite)
    return warning


def _obj(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> bytes:
    return f"{_coordinates('v ', vertices)}{_numbers('f', faces + 1)}".encode()


def _off(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> bytes:
    head = f"OFF\n{len(vertices)} {len(faces)} 0\n"
    return f"{head}{_coordinates('', vertices)}{_numbers('3', faces)}".encode()


def _coordinates(start: str, vertices: npt.NDArray[np.float64]) -> str:
    """Lines with as many digits as a float32 has at the origin, and more far from it."""
    far = np.log10(np.abs(vertices).max() / np.ptp(vertices, axis=0).max())
    digits = min(9 + max(0, int(np.ceil(far))), 17)
    return "".join([f"{start}{x:.{digits}g} {y:.{digits}g} {z:.{digits}g}\n" for x, y, z in vertices.tolist()])


def _numbers(start: str, faces: npt.NDArray[np.int64]) -> str:
    return "".join([f"{start} {a} {b} {c}\n" for a, b, c in faces.tolist()])


def _double_ply(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> bytes:
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    return head.encode() + vertices.astype("<f8").tobytes() + records.tobytes()


def _moved_glb(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> bytes:
    trimesh = require("trimesh", "mesh")
    middle = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
    scene = trimesh.Scene()
    at = np.eye(4)
    at[:3, 3] = middle
    scene.add_geometry(trimesh.Trimesh(vertices - middle, faces, process=False), transform=at)
    return scene.export(file_type="glb")
