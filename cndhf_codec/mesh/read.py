"""Read files, streams or arrays as one checked triangle mesh in input coordinates."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
import numpy.typing as npt
import zstandard

from ..arrays import F64, I64, Mask
from ..errors import InputError, MeshError, MissingExtraError, first_line, require
from ..files import read_bytes
from .formats import gltf, obj, off, ply, recognise, stl, threemf
from .formats.accessors import Fetch
from .formats.common import Triangles, UnreadableError, shown

READERS: dict[str, Callable[[bytes, Fetch], Triangles]] = {
    "obj": lambda data, _: obj.read_obj(data),
    "ply": lambda data, _: ply.read_ply(data),
    "stl": lambda data, _: stl.read_stl(data),
    "off": lambda data, _: off.read_off(data),
    "glb": gltf.read_glb,
    "gltf": gltf.read_gltf,
    "3mf": lambda data, _: threemf.read_3mf(data),
}
EXTENSIONS = tuple(f".{kind}" for kind in READERS)
PACKED = {b"\x1f\x8b": ".gz", b"BZh": ".bz2", b"\xfd7zXZ\0": ".xz", b"\x28\xb5\x2f\xfd": ".zst"}  # by their first bytes
MOST_BYTES = 2**34  # of a file
MOST_TIMES = 1000  # bytes that may come out of each byte of a compressed file
PIECE = 2**20
Number = TypeVar("Number", bound=np.generic)

FACES_AT_ONCE = 2**20  # faces checked together: bounds the memory that large meshes take
LEAST_RADIUS, MOST_RADIUS = 1e-30, 1e30  # of a mesh: what float32 can hold


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with no zero-area face, no unused vertex, equal positions merged, and vertices and faces sorted.

    vertices: (N, 3) float64. faces: (M, 3) int64. dropped: number of zero-area faces left out. notes: a line for each
    thing in the file that was not read as it stands. lost: what else the file holds of the surface's looks or motion.
    """

    vertices: F64
    faces: I64
    name: str
    dropped: int
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()

    @property
    def triangles(self) -> F64:
        """(M, 3, 3) corner positions."""
        return self.vertices[self.faces]


def read_mesh(source: Any) -> Mesh:
    """Read a mesh from a path, a binary stream, a `trimesh.Trimesh` or `Scene`, or a (vertices, faces) pair.

    Files are OBJ, PLY, STL, OFF, GLB, glTF (with its .bin) or 3MF, and may be compressed with gzip, bzip2, xz or zstd.
    The content decides the format; where the name says otherwise, the mesh has a note. Scenes are flattened with their
    transforms. Raises InputError when the file cannot be opened, MeshError when it is damaged, holds what is not read,
    or has no triangles with finite coordinates, and MissingExtraError for a glTF compressed with Draco or meshoptimizer
    without the `gltf` extra.
    """
    if isinstance(source, (str, os.PathLike)):
        return _of_file(Path(source))
    if isinstance(source, tuple) and len(source) == 2:
        try:
            if any(np.iscomplexobj(part) for part in source):
                raise TypeError
            vertices, faces = (np.asarray(part, dtype=np.float64) for part in source)
        except (TypeError, ValueError) as exc:
            raise MeshError("the mesh: vertices and faces must be arrays of numbers") from exc
        return checked(vertices, faces, "the mesh")
    if hasattr(source, "read"):
        return _of_stream(source)
    if hasattr(source, "geometry"):
        source = _flatten(source, "the scene")
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return checked(np.asarray(source.vertices), np.asarray(source.faces), "the mesh")
    raise MeshError(
        f"cannot make a mesh of a {type(source).__name__}; give a path, a binary stream, a trimesh.Trimesh or "
        "(vertices, faces)"
    )


def _of_file(path: Path) -> Mesh:
    try:
        exists, is_folder, is_file = path.exists(), path.is_dir(), path.is_file()
    except (OSError, ValueError) as exc:  # a name too long, a folder that may not be looked into, a zero byte
        raise InputError(f"{path}: cannot be read: {getattr(exc, 'strerror', exc)}") from exc
    if not exists:
        raise InputError(f"{path}: no such file")
    if is_folder:
        raise InputError(f"{path}: is a folder; name a mesh file")
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] in PACKED.values():
        suffixes.pop()
    kind = suffixes[-1][1:] if suffixes else ""
    if is_file and kind and kind not in READERS:  # a pipe has no extension, or any
        raise InputError(
            f"{path}: unknown mesh extension; these are read: {', '.join(EXTENSIONS)}, "
            "and .gz, .bz2, .xz, .zst of them; convert it, or rename it if it is one of them"
        )
    return _of_bytes(read_bytes(path, MOST_BYTES), str(path), kind if kind in READERS else None, _beside(path))


def _of_stream(stream: BinaryIO) -> Mesh:
    name = "standard input" if stream is getattr(sys.stdin, "buffer", None) else "the stream"
    data = bytearray()
    try:
        if getattr(stream, "isatty", bool)():
            raise InputError(f"{name}: is a terminal; pipe a mesh into it, or name a file")
        # In pieces: a pipe may give fewer bytes than it is asked for, and one large call takes memory for all of them.
        while piece := stream.read(PIECE):
            if not isinstance(piece, bytes):
                raise InputError(f"{name}: is not open for bytes")
            data += piece
            if len(data) >= MOST_BYTES:
                break
    except (OSError, EOFError, ValueError, zlib.error, lzma.LZMAError) as exc:
        raise InputError(f"{name}: cannot be read: {first_line(exc)}") from exc

    def beside(uri: str) -> bytes:
        raise UnreadableError(f"names the file {shown(uri, 80)} beside it; give the path of the .gltf, or a .glb")

    return _of_bytes(bytes(data), name, None, beside)


def _of_bytes(data: bytes, name: str, kind: str | None, beside: Fetch) -> Mesh:
    """Read a file's bytes. kind: the format that the name says; None where there is no name."""
    try:
        if len(data) == MOST_BYTES:
            raise UnreadableError(f"has {MOST_BYTES} bytes or more, which is more than is read")
        data = unpacked(data)
        if data.startswith(tuple(PACKED)):
            raise UnreadableError("is compressed twice; unpack it once")
        found = recognise.recognise(data)
        if found in (None, "obj"):  # other text may look like OBJ
            recognise.check_foreign(data)
            if found is None and kind is None:
                raise UnreadableError("its content is of no format that is read: " + ", ".join(READERS))
        with np.errstate(over="ignore", invalid="ignore"):  # `checked` says what is not finite or too large
            read = READERS[found or kind or ""](data, beside)
    except UnreadableError as exc:
        raise MeshError(f"{name}: {exc}") from exc
    except MissingExtraError as exc:
        raise MissingExtraError(f"{name}: is compressed; {exc}") from exc
    notes = read.notes
    if found is not None and kind is not None and found != kind:
        notes = [f"the content is {found.upper()}, whatever the name says, and was read as such", *notes]
    return replace(checked(read.vertices, read.faces, name), notes=tuple(notes), lost=tuple(read.lost))


def unpacked(data: bytes) -> bytes:
    """Decompress a file's bytes; those of other files are returned as they are. Raises UnreadableError."""
    ending = next((ending for magic, ending in PACKED.items() if data.startswith(magic)), None)
    if ending is None:
        return data
    out = bytearray()
    try:
        for piece in _zst_pieces(data) if ending == ".zst" else _pieces(ending, data):
            out += piece
            if len(out) > MOST_TIMES * len(data) + PIECE:
                raise UnreadableError(f"{len(data)} bytes hold more than {MOST_TIMES} times as many: no mesh does")
    except (OSError, EOFError, zlib.error, lzma.LZMAError, zstandard.ZstdError) as exc:
        raise UnreadableError(f"the compressed file ({ending}) is damaged or cut short: {first_line(exc)}") from exc
    return bytes(out)


def _pieces(ending: str, data: bytes) -> Iterator[bytes]:
    packed = io.BytesIO(data)
    opener: Any = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}[ending]
    file = opener(packed)
    while piece := file.read(PIECE):
        yield piece


def _zst_pieces(data: bytes) -> Iterator[bytes]:
    # A kilobyte at a time: only a few megabytes can come of it. The library's own reader does not report a cut file.
    machine = zstandard.ZstdDecompressor(max_window_size=2**27).decompressobj()
    for at in range(0, len(data), 2**10):
        rest = data[at : at + 2**10]
        while rest:
            if machine.eof:  # another frame follows
                machine = zstandard.ZstdDecompressor(max_window_size=2**27).decompressobj()
            yield machine.decompress(rest)
            rest = machine.unused_data if machine.eof else b""
    if not machine.eof:
        raise EOFError("its end is missing")


def _beside(path: Path) -> Fetch:
    """Return a reader of the files that a .gltf names, in its folder and those below it."""

    def fetch(uri: str) -> bytes:
        folder = path.absolute().parent
        target = Path(os.path.normpath(folder / uri))
        if ":" in uri or not target.is_relative_to(folder):
            raise UnreadableError(f"names {shown(uri, 80)}, which is not in its own folder: it is not fetched")
        try:
            return read_bytes(target, MOST_BYTES)
        except (InputError, ValueError) as exc:
            raise UnreadableError(f"names {shown(uri, 80)}, which cannot be read beside it; copy both") from exc

    return fetch


def _flatten(scene: Any, name: str) -> Any:
    trimesh = require("trimesh", "mesh")
    meshes = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh)]
    if not meshes:
        raise MeshError(f"{name}: holds no triangles (a point cloud or curves?)")
    return trimesh.util.concatenate(meshes)


def checked(vertices: np.ndarray, faces: np.ndarray, name: str) -> Mesh:
    """Make a checked mesh of arrays, whatever they hold. Raises MeshError, whose message names the mesh."""
    if faces.size == 0:
        raise MeshError(f"{name}: has no faces")
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshError(
            f"{name}: vertices of shape (N, 3) and triangles of shape (M, 3) are needed; "
            f"got {vertices.shape} and {faces.shape}"
        )
    if (
        faces.dtype.kind == "f"
        and not (np.isfinite(faces) & (faces == np.floor(faces)) & (np.abs(faces) < 2**53)).all()
    ):
        raise MeshError(f"{name}: a face names a vertex by a number that is not whole")
    vertices, faces = vertices.astype(np.float64), faces.astype(np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        worst = faces.min() if faces.min() < 0 else faces.max()
        raise MeshError(f"{name}: a face names vertex {worst}, but there are {len(vertices)} vertices")
    named = np.zeros(len(vertices), dtype=bool)
    named[faces] = True
    if not np.isfinite(vertices[named]).all():
        raise MeshError(f"{name}: a vertex coordinate is NaN or infinite")
    check_size(vertices[named], name)
    vertices, number = distinct_rows(vertices + 0.0)  # -0 becomes 0
    faces = number[faces]
    solid = np.concatenate(
        [_has_area(vertices, faces[at : at + FACES_AT_ONCE]) for at in range(0, len(faces), FACES_AT_ONCE)]
    )
    dropped = int(len(faces) - solid.sum())
    faces = faces[solid]
    if not len(faces):
        raise MeshError(f"{name}: every face has zero area")
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return Mesh(vertices[used], _in_order((np.cumsum(used) - 1)[faces]), name, dropped)


def check_size(vertices: F64, name: str) -> None:
    """Raise MeshError for a mesh that is too large, too small or too far away for the float32 of a file's frame."""
    lo, hi = vertices.min(axis=0), vertices.max(axis=0)
    half = hi / 2 - lo / 2
    largest = float(half.max())
    radius = largest * float(np.linalg.norm(half / largest)) if largest > 0 else 0.0
    if radius > 0 and not LEAST_RADIUS < radius < MOST_RADIUS:  # at radius 0 no face has an area: another error
        raise MeshError(f"{name}: its size ({2 * radius:g}) is outside {LEAST_RADIUS:g} to {MOST_RADIUS:g}; rescale it")
    if np.abs(vertices).max() > MOST_RADIUS:
        raise MeshError(
            f"{name}: its place ({np.abs(vertices).max():g}) is beyond {MOST_RADIUS:g}; move it to the origin"
        )


def distinct_rows(rows: npt.NDArray[Number]) -> tuple[npt.NDArray[Number], I64]:
    """Find the distinct rows of (N, d), sorted by their first column, then the second, and so on; and which of them
    each row is, (N,). As numpy's `unique` by rows, in less time and memory."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(order), dtype=bool)
    np.any(ordered[1:] != ordered[:-1], axis=1, out=new[1:])
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], number


def _has_area(vertices: F64, faces: I64) -> Mask:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    # Relative to the longest edge, so that the test means the same in metres and in micrometres.
    edge = np.linalg.norm(np.stack([b - a, c - b, a - c]), axis=2).max(axis=0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12 * edge**2)


def _in_order(faces: I64) -> I64:
    """Begin every face at its least vertex and sort the faces. The order in the input no longer matters then, so that
    one geometry gives one .cndhf file whatever the format it came in."""
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return faces[np.lexsort(faces.T[::-1])]
