"""Mesh input: files through trimesh, or arrays, as one checked triangle mesh in input coordinates."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ..errors import InputError, MeshError, require

EXTENSIONS = (".obj", ".ply", ".stl", ".off", ".glb")
Number = TypeVar("Number", bound=np.generic)

AT_ONCE = 2**20  # faces looked at together: bounds the memory that large meshes take


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with no zero-area face, no unused vertex, equal positions merged, and vertices and faces sorted.

    vertices: (N, 3) float64. faces: (M, 3) int64. dropped: how many zero-area faces were left out.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    name: str
    dropped: int

    @property
    def triangles(self) -> npt.NDArray[np.float64]:
        """(M, 3, 3) corner positions."""
        return self.vertices[self.faces]


def read_mesh(source: Any) -> Mesh:
    """Mesh from a path, a `trimesh.Trimesh` or `Scene`, or a (vertices, faces) pair.

    A scene is flattened with its transforms. Raises InputError when the file cannot be read and MeshError
    when it does not hold triangles with finite coordinates.
    """
    if isinstance(source, (str, os.PathLike)):
        return checked(*_load(Path(source)), str(Path(source)))
    if isinstance(source, tuple) and len(source) == 2:
        try:
            vertices, faces = (np.asarray(part, dtype=np.float64) for part in source)
        except (TypeError, ValueError) as exc:
            raise MeshError("the mesh: vertices and faces must be arrays of numbers") from exc
        if not np.array_equal(faces, np.floor(faces)):
            raise MeshError("the mesh: a face names a vertex by a number that is not whole")
        return checked(vertices, faces, "the mesh")
    if hasattr(source, "geometry"):
        source = _flatten(source, "the scene")
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return checked(np.asarray(source.vertices), np.asarray(source.faces), "the mesh")
    raise MeshError(
        f"cannot make a mesh of a {type(source).__name__}; give a path, a trimesh.Trimesh or (vertices, faces)"
    )


def _load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    trimesh = require("trimesh", "encode")
    try:
        exists, is_folder = path.exists(), path.is_dir()
    except OSError as exc:  # a name too long, a folder that may not be looked into
        raise InputError(f"{path}: cannot be read: {exc.strerror}") from exc
    if not exists:
        raise InputError(f"{path}: no such file")
    if is_folder:
        raise InputError(f"{path}: is a folder; name a mesh file")
    if path.suffix.lower() not in EXTENSIONS:
        raise InputError(f"{path}: unknown mesh extension; these are read: {', '.join(EXTENSIONS)}")
    try:
        loaded = trimesh.load(path, process=False)
    except Exception as exc:  # trimesh's loaders raise whatever their parsers raise
        raise MeshError(f"{path}: cannot be read as a {path.suffix[1:].upper()} mesh: {_line(exc)}") from exc
    if isinstance(loaded, trimesh.Scene):
        loaded = _flatten(loaded, str(path))
    if not hasattr(loaded, "faces"):
        raise MeshError(f"{path}: holds no triangles (a point cloud or curves?)")
    return np.asarray(loaded.vertices), np.asarray(loaded.faces)


def _flatten(scene: Any, name: str) -> Any:
    trimesh = require("trimesh", "encode")
    meshes = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh)]
    if not meshes:
        raise MeshError(f"{name}: holds no triangles (a point cloud or curves?)")
    return trimesh.util.concatenate(meshes)


def checked(vertices: np.ndarray, faces: np.ndarray, name: str) -> Mesh:
    """The mesh of these arrays, whatever they hold. Raises MeshError, which calls the mesh by its name."""
    if faces.size == 0:
        raise MeshError(f"{name}: has no faces")
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshError(
            f"{name}: vertices of shape (N, 3) and triangles of shape (M, 3) are needed; "
            f"got {vertices.shape} and {faces.shape}"
        )
    vertices, faces = vertices.astype(np.float64), faces.astype(np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        worst = faces.min() if faces.min() < 0 else faces.max()
        raise MeshError(f"{name}: a face names vertex {worst}, but there are {len(vertices)} vertices")
    named = np.zeros(len(vertices), dtype=bool)
    named[faces] = True
    if not np.isfinite(vertices[named]).all():
        raise MeshError(f"{name}: a vertex coordinate is NaN or infinite")
    vertices, number = distinct_rows(vertices + 0.0)  # -0 becomes 0
    faces = number[faces]
    solid = np.concatenate([_has_area(vertices, faces[at : at + AT_ONCE]) for at in range(0, len(faces), AT_ONCE)])
    dropped = int(len(faces) - solid.sum())
    faces = faces[solid]
    if not len(faces):
        raise MeshError(f"{name}: every face has zero area")
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return Mesh(vertices[used], _in_order((np.cumsum(used) - 1)[faces]), name, dropped)


def distinct_rows(rows: npt.NDArray[Number]) -> tuple[npt.NDArray[Number], npt.NDArray[np.int64]]:
    """The distinct rows of (N, d), sorted by their first column, then the second, and so on; and which of them each row
    is, (N,). As numpy's `unique` by rows, in less time and memory."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(order), dtype=bool)
    np.any(ordered[1:] != ordered[:-1], axis=1, out=new[1:])
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], number


def _has_area(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    # Relative to the longest edge, so that the test means the same in metres and in micrometres.
    edge = np.linalg.norm(np.stack([b - a, c - b, a - c]), axis=2).max(axis=0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12 * edge**2)


def _in_order(faces: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Every face from its least vertex on, and the faces sorted: what a file's order of faces and vertices was is
    forgotten, so that one geometry gives one file whatever the format it came in."""
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return faces[np.lexsort(faces.T[::-1])]


def _line(exc: Exception) -> str:
    text = str(exc).strip().splitlines()
    return text[0] if text else type(exc).__name__
