"""Read OFF and its kin (COFF, NOFF, STOFF, 4OFF): Geomview's object file format, ASCII.

Each vertex and each face has a line of its own; where lines end elsewhere, the file is read word by word.
"""

from __future__ import annotations

import re

import numpy as np

from ...arrays import F64, I64
from .common import Triangles, UnreadableError, check_indices, left_out, lines_of, number, numbers, shown, whole
from .polygons import triangulate

# Prefixes come in any order. A lower-case n before OFF means any number of dimensions.
KEYWORD = re.compile(r"((?:ST|C|N|4)*)OFF", re.IGNORECASE)


def read_off(data: bytes) -> Triangles:
    lines, places = [], []
    for at, line in enumerate(lines_of(data)):
        line = line.partition("#")[0].strip() if "#" in line else line.strip()
        if line:
            lines.append(line)
            places.append(at + 1)
    extra, homogeneous = _take_keyword(lines, places)
    vertex_count, face_count = _take_counts(lines, places)
    notes = []
    if not face_count:
        raise UnreadableError(f"holds no triangles: {vertex_count} vertices and no faces (a point cloud?)")
    columns = 4 if homogeneous else 3
    wrapped = len(lines) < vertex_count + face_count or not _line_is_a_face(lines[vertex_count])
    if wrapped or (vertex_count and len(lines[0].split()) < columns):
        vertices, corners, sizes, rest = _words(lines, vertex_count, face_count, columns, extra)
        if rest or sizes.min() < 3:  # colours, read as faces
            raise UnreadableError(
                f"is cut short: {vertex_count} vertices and {face_count} faces are declared, "
                f"there are {len(lines)} lines"
            )
    else:
        vertices = _vertices(lines[:vertex_count], places, homogeneous, extra)
        corners, sizes = _faces(lines[vertex_count:][:face_count], places[vertex_count:])
        notes += left_out(len(lines) - vertex_count - face_count, "lines behind the last face")
    if homogeneous:
        if (vertices[:, 3] == 0).any():
            raise UnreadableError(
                f"vertex {int((vertices[:, 3] == 0).argmax())} has the weight 0: it is infinitely far"
            )
        vertices = vertices[:, :3] / vertices[:, 3:]
    starts = np.cumsum(sizes) - sizes
    check_indices(corners, len(vertices), lambda k: f"face {np.searchsorted(starts, k, 'right') - 1}")
    faces, more = triangulate(vertices, corners, sizes)
    return Triangles(vertices, faces, notes + more)


def _take_keyword(lines: list[str], places: list[int]) -> tuple[bool, bool]:
    """Take `OFF` or the like from the first line. Returns whether vertices have colours, normals or texture
    coordinates, too, and whether they have four coordinates."""
    if not lines:
        raise UnreadableError("holds nothing but comments")
    match = KEYWORD.match(lines[0])
    if not match:
        return False, False  # the keyword is optional
    rest = lines[0][match.end() :].strip()
    if rest.lower().startswith("binary"):
        raise UnreadableError("is a binary OFF file, which is not read; save it as ASCII OFF, or as PLY")
    prefix = match[1].upper()
    if "nOFF" in match[0]:
        raise UnreadableError(
            f"is of the kind {shown(match[0])}, of any number of dimensions, which is not read; save it as OFF"
        )
    if rest:  # the counts stand on the same line
        lines[0] = rest
    else:
        del lines[0], places[0]
    return bool(set(prefix) - {"4"}), "4" in prefix


def _take_counts(lines: list[str], places: list[int]) -> tuple[int, int]:
    """Take the numbers of vertices, faces and, if present, edges from the first line."""
    if not lines:
        raise UnreadableError("ends before the numbers of vertices and faces")
    words, where = lines[0].split(), f"line {places[0]}"
    if not 2 <= len(words) <= 3:  # lines end anywhere: take the next three words
        words = " ".join(lines).split(None, 3)
        words, rest = words[:3], words[3:]
        lines[1:], places[1:] = rest, places[:1] * len(rest)
    if len(words) < 2 or not all(w.isascii() and w.isdigit() for w in words[:2]):  # edges are not used
        raise UnreadableError(f"{where}: {shown(lines[0])} where the numbers of vertices, faces and edges should stand")
    vertices, faces = (whole(word, where) for word in words[:2])
    del lines[0], places[0]
    return vertices, faces


def _line_is_a_face(line: str) -> bool:
    """Whether a line has a number of corners and as many of them."""
    words = line.split()
    return words[0].isascii() and words[0].isdigit() and len(words[0]) <= 9 and len(words) > int(words[0])


def _vertices(lines: list[str], places: list[int], homogeneous: bool, extra: bool) -> F64:
    """Read vertices (N, 3), or (N, 4) with weights; what follows the coordinates is ignored."""
    columns = 4 if homogeneous else 3
    table = numbers(lines)
    if table is None or table.shape[1] < columns:
        rows = []
        for line, place in zip(lines, places, strict=False):
            words = line.split()[:columns]
            if not extra and len(line.split()) != len(lines[0].split()):
                raise UnreadableError(
                    f"line {place}: has {len(line.split())} numbers, the first vertex {len(lines[0].split())}: "
                    "the number of vertices may be wrong"
                )
            if len(words) < columns:
                raise UnreadableError(f"line {place}: a vertex needs {columns} coordinates, here are {len(words)}")
            rows.append([number(word, f"line {place}") for word in words])
        table = np.array(rows, dtype=np.float64).reshape(-1, columns)
    return table[:, :columns]


def _faces(lines: list[str], places: list[int]) -> tuple[I64, I64]:
    """Read the corners of all faces, and how many each face has; the colours behind them are ignored."""
    table = numbers(lines)
    if table is not None and (table[:, 0] == 3).all() and table.shape[1] >= 4:
        triangles = table[:, 1:4]
        if np.array_equal(triangles, np.rint(triangles)) and np.abs(triangles).max() < 2**53:
            return triangles.astype(np.int64).ravel(), np.full(len(lines), 3)
    corners: list[int] = []
    sizes = []
    for line, place in zip(lines, places, strict=False):
        words, where = line.split(), f"line {place}"
        n = whole(words[0], where)
        if not 0 <= n < len(words):
            raise UnreadableError(f"{where}: a face of {n} corners, but {len(words) - 1} numbers")
        corners += [whole(word, where) for word in words[1 : n + 1]]
        sizes.append(n)
    return np.array(corners, dtype=np.int64), np.array(sizes)


def _words(lines: list[str], vertices: int, faces: int, columns: int, extra: bool) -> tuple[F64, I64, I64, int]:
    """As `_vertices` and `_faces`, word by word wherever lines end; returns also how many words are left."""
    words = " ".join(lines).split()
    short = f"is cut short: {vertices} vertices and {faces} faces are declared, "
    if len(words) < columns * vertices:
        raise UnreadableError(f"{short}there are numbers for {len(words) // columns} vertices")
    if extra:
        raise UnreadableError(f"{short}there are {len(lines)} lines; a vertex with colours or normals must be a line")
    points = [number(word, "a vertex") for word in words[: columns * vertices]]
    corners: list[int] = []
    sizes: list[int] = []
    at = columns * vertices
    for k in range(faces):
        n = whole(words[at], f"face {k}") if at < len(words) else 0
        if at >= len(words) or n < 0 or at + n >= len(words):
            raise UnreadableError(f"{short}it ends within face {k}")
        corners += [whole(word, f"face {k}") for word in words[at + 1 : at + 1 + n]]
        sizes.append(n)
        at += n + 1
    return (
        np.array(points, dtype=np.float64).reshape(-1, columns),
        np.array(corners, dtype=np.int64),
        np.array(sizes),
        len(words) - at,
    )
