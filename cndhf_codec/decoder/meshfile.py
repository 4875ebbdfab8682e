"""Mesh files out: PLY and STL through trimesh where it keeps the precision of the coordinates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import path_like
from ..arrays import F64, I64
from ..errors import OptionError
from ..files import write_atomically
from .glb import Embedded, glb_bytes

EXTENSIONS = (".ply", ".obj", ".stl", ".off", ".glb")
WITH_NORMALS = ("ply", "obj", "glb")
NEGLIGIBLE_ROUNDING = 1e-6  # of the mesh's longest side


def check_extension(path: str | os.PathLike[str]) -> str:
    """The path's extension in lower case, without its dot. Raises OptionError for a format that is not written."""
    suffix = Path(path_like(path)).suffix.lower()
    if suffix not in EXTENSIONS:
        raise OptionError(f"{Path(path)}: unknown mesh extension; these are written: {', '.join(EXTENSIONS)}")
    return suffix[1:]


def check_normals(path: str | os.PathLike[str]) -> None:
    """Raise OptionError when the path's format holds no vertex normals."""
    if check_extension(path) not in WITH_NORMALS:
        raise OptionError(f"{Path(path)}: this format holds no vertex normals; .ply, .obj and .glb do")


def check_embedded(path: str | os.PathLike[str]) -> None:
    """Raise OptionError when the path's format cannot carry a .cndhf file."""
    if check_extension(path) != "glb":
        raise OptionError(f"{Path(path)}: this format carries no .cndhf file; .glb does")


def mesh_bytes(
    mesh: Any, extension: str, with_normals: bool = False, embedded: Embedded | None = None
) -> tuple[bytes, str | None]:
    """The bytes of a mesh file, and a warning when the format cannot keep the precision of the coordinates.

    At a great distance from the origin, float32 rounds coordinates by more than a millionth of the mesh's size. A PLY
    then holds float64, and a GLB moves its mesh by the transform of a node; STL has float32 only, hence the warning.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh.
    extension : str
        One of `EXTENSIONS`, without its dot.
    with_normals : bool
        Write vertex normals, too.
    embedded : Embedded, optional
        Of GLB: the .cndhf file of the mesh, to be carried beside or in place of it (spec/gltf.md).

    Returns
    -------
    data : bytes
    warning : str or None

    Examples
    --------
    >>> import cndhf_codec
    >>> from cndhf_codec.decoder.meshfile import mesh_bytes
    >>> mesh = cndhf_codec.load("tests/golden/encoded.cndhf").to_mesh(16)
    >>> data, warning = mesh_bytes(mesh, "off")
    >>> data[:3], warning
    (b'OFF', None)
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    normals = np.asarray(mesh.vertex_normals) if with_normals else None
    size = float(np.ptp(vertices, axis=0).max())
    rounding = float(np.spacing(np.float32(np.abs(vertices).max())) / 2)
    coarse = rounding > NEGLIGIBLE_ROUNDING * size
    if extension == "obj":
        return _obj(vertices, faces, normals), None
    if extension == "off":
        return _off(vertices, faces), None
    if extension == "ply" and coarse:
        return _double_ply(vertices, faces, normals), None
    if extension == "glb":
        middle = vertices.min(axis=0) / 2 + vertices.max(axis=0) / 2
        return glb_bytes(vertices, faces, normals, middle if coarse else np.zeros(3), embedded), None
    options = {"vertex_normal": with_normals} if extension == "ply" else {}
    data = mesh.export(file_type=extension, **options)
    if not coarse:
        return data, None
    return data, (
        f"STL holds float32: so far from the origin positions are rounded by {rounding:.2g}; "
        "write .ply, .obj, .off or .glb to keep them"
    )


def write_mesh(
    mesh: Any,
    path: str | os.PathLike[str],
    overwrite: bool = False,
    with_normals: bool = False,
    embedded: Embedded | None = None,
) -> str | None:
    """Write a mesh file. When that fails, nothing is left, and an older file stays as it was.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh.
    path : str or path-like
        Where to; its extension, one of `EXTENSIONS`, says the format.
    overwrite : bool
        Replace a file that exists.
    with_normals : bool
        Write vertex normals, too.
    embedded : Embedded, optional
        As for `mesh_bytes`.

    Returns
    -------
    str or None
        The warning of `mesh_bytes`, after the path.

    Raises
    ------
    OptionError
        When the path is of another type or extension, or its format holds no normals or no .cndhf file.
    OutputError
        When the file cannot be written, or exists and may not be overwritten.

    Examples
    --------
    >>> import cndhf_codec, tempfile
    >>> from cndhf_codec.decoder.meshfile import write_mesh
    >>> mesh = cndhf_codec.load("tests/golden/encoded.cndhf").to_mesh(16)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mesh(mesh, f"{folder}/bracket.ply")
    """
    extension = check_extension(path)
    if with_normals:
        check_normals(path)
    if embedded is not None:
        check_embedded(path)
    data, warning = mesh_bytes(mesh, extension, with_normals, embedded)
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
    """Lines of coordinates, each with the digits of a float32, and more at a great distance from the origin."""
    distance = np.log10(np.abs(vertices).max() / np.ptp(vertices, axis=0).max())
    digits = min(9 + max(0, int(np.ceil(distance))), 17)
    return "".join([f"{start}{x:.{digits}g} {y:.{digits}g} {z:.{digits}g}\n" for x, y, z in vertices.tolist()])


def _numbers(start: str, faces: I64) -> str:
    """Lines of three vertex numbers."""
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
