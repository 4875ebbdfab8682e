"""Read Wavefront OBJ: vertices and faces, by the "Advanced Visualizer" manual, appendix B1."""

from __future__ import annotations

import re

import numpy as np

from ...arrays import I64
from .common import Triangles, UnreadableError, left_out, lines_of, number, numbers, shown, whole
from .polygons import triangulate

SURFACE_FREE = {  # statements that say nothing about the surface
    *("vn", "vt", "vp", "g", "o", "s", "mg", "mtllib", "usemtl", "maplib", "usemap", "bevel", "c_interp", "d_interp"),
    *("lod", "shadow_obj", "trace_obj"),
}
NAMING = ("g", "o", "mtllib", "usemtl", "maplib", "usemap", "shadow_obj", "trace_obj")
FREE_FORM = {  # curves and surfaces, which would have to be divided into triangles
    *("cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end", "con"),
    *("ctech", "stech", "bsp", "bzp", "cdc", "cdp", "res"),
}


def read_obj(data: bytes) -> Triangles:
    lines = lines_of(data)
    _join_continued(lines)
    vertex_at: list[int] = []
    face_at: list[int] = []
    face_words: list[str] = []
    ignored: dict[str, int] = {}
    unknown: dict[str, int] = {}
    for at, line in enumerate(lines):
        head = line[:2]
        if head == "v ":
            vertex_at.append(at)
        elif head == "f ":
            face_at.append(at)
            face_words.append(line[2:])
        elif head not in ("vn", "vt", "", "# "):
            words = line.split(None, 1)
            word = words[0].lower() if words else "#"
            if word == "v":
                vertex_at.append(at)
            elif word in ("f", "fo"):  # `fo` is how faces were once written
                face_at.append(at)
                face_words.append(words[1] if len(words) > 1 else "")
            elif word in ("l", "p"):
                ignored[word] = ignored.get(word, 0) + 1
            elif word in FREE_FORM or word in ("call", "csh"):
                what = "a free-form curve or surface" if word in FREE_FORM else "a command that includes other files"
                raise UnreadableError(f"line {at + 1}: '{word}' is {what}, which is not read; export triangles")
            elif not word.startswith("#") and word not in SURFACE_FREE:
                unknown.setdefault(word, at + 1)
    if not face_at:
        kinds = [
            f"{len(vertex_at)} vertices",
            *(f"{n} {'lines' if w == 'l' else 'points'}" for w, n in ignored.items()),
        ]
        first = f"; line {min(unknown.values())} is no OBJ statement" if unknown else ""
        raise UnreadableError(f"holds no triangles: no 'f' statement, {', '.join(kinds)}{first}")
    vertices = _vertices(lines, vertex_at)
    corners, sizes = _faces(face_words, face_at, np.array(vertex_at))
    faces, notes = triangulate(vertices, corners, sizes)
    notes += left_out(sum(ignored.values()), "points and lines, which bound no surface,")
    for word, at in list(unknown.items())[:3]:
        notes.append(f"line {at}: {shown(word)} is no OBJ statement known here; it was not read")
    lost = [name for mark, name in ((b"\nvt", "texture coordinates"), (b"\nusemtl", "materials")) if mark in data]
    if vertex_at and len(lines[vertex_at[0]].partition("#")[0].split()) >= 7:
        lost.append("colours")
    return Triangles(vertices, faces, notes, lost)


def _join_continued(lines: list[str]) -> None:
    """Join lines that end in a backslash to the lines after them, which become empty. A backslash at the end of a
    comment or of a name (a Windows folder) joins nothing."""
    for at in range(len(lines) - 2, -1, -1):
        line = lines[at].rstrip()
        if line.endswith("\\") and "#" not in line and line.split(None, 1)[0].lower() not in NAMING:
            lines[at] = f"{line[:-1]} {lines[at + 1]}"
            lines[at + 1] = ""


def _vertices(lines: list[str], at: list[int]) -> np.ndarray:
    """Read vertices (N, 3); weights and colours behind the coordinates are ignored."""
    if not at:
        return np.empty((0, 3))
    try:
        return np.loadtxt([lines[k] for k in at], usecols=(1, 2, 3), comments="#", ndmin=2).reshape(len(at), 3)
    except ValueError:  # find the faulty line below
        pass
    out = np.empty((len(at), 3))
    for row, k in enumerate(at):
        words = lines[k].partition("#")[0].split()[1:]
        if len(words) < 3:
            raise UnreadableError(f"line {k + 1}: a vertex needs three coordinates, here are {len(words)}")
        out[row] = [number(word, f"line {k + 1}") for word in words[:3]]
    return out


def _faces(words: list[str], at: list[int], vertex_at: I64) -> tuple[I64, I64]:
    """Read the corners of all faces, counted from 0, and how many each face has.

    words: what follows each `f`, on line `at`. Negative indices count back from the last vertex before the face.
    """
    text = "\n".join(words)
    if "/" in text:
        words = re.sub(r"/\S*", "", text).split("\n")
    table = numbers(words, "#")
    if table is not None and np.array_equal(table, np.rint(table)) and np.abs(table).max() < 2**53:
        corners = table.astype(np.int64).ravel()
        sizes = np.full(len(words), table.shape[1])
    else:
        rows = [row.partition("#")[0].split() for row in words]
        sizes = np.array([len(row) for row in rows])
        corners = np.array(
            [whole(w, f"line {k + 1}") for row, k in zip(rows, at, strict=True) for w in row], dtype=np.int64
        )
    if (corners > 0).all() and corners.max(initial=0) <= len(vertex_at):
        return corners - 1, sizes
    line = np.repeat(np.array(at), sizes)
    known = np.searchsorted(vertex_at, line)  # vertices before the line
    counted = np.where(corners > 0, corners - 1, known + corners)
    wrong = (corners == 0) | (counted < 0) | (counted >= len(vertex_at))
    if wrong.any():
        k = int(wrong.argmax())
        place, index = f"line {line[k] + 1}", int(corners[k])
        if index == 0:
            raise UnreadableError(f"{place}: index 0 is not allowed: OBJ counts vertices from 1")
        if index < 0:
            raise UnreadableError(f"{place}: index {index} reaches back before the first of {known[k]} vertices")
        raise UnreadableError(f"{place}: names vertex {index}, but the file has {len(vertex_at)}")
    return counted, sizes
