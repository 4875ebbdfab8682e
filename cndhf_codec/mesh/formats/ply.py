"""Read PLY, ASCII and binary: vertices, faces and triangle strips (Turk, "The PLY Polygon File Format").

Every element is read as the header declares it. Left-over bytes are noted, and missing ones are an error.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...arrays import F64, I64
from .common import Triangles, UnreadableError, check_indices, joined, left_out, lines_of, number, numbers, shown, whole
from .polygons import triangulate

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
LOST = {  # properties that are named as lost
    "colours": {"red", "diffuse_red", "r"},
    "texture coordinates": {"s", "u", "texture_u", "texcoord", "texnumber"},
}
CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class Property:
    """A property of an element. kind: numpy's name of the numbers' type. count: the type of a list's length, or None
    for one number."""

    name: str
    kind: str
    count: str | None


@dataclass
class Element:
    name: str
    rows: int
    properties: list[Property]

    @property
    def lists(self) -> list[int]:
        return [k for k, p in enumerate(self.properties) if p.count is not None]


@dataclass(frozen=True)
class Ragged:
    """Lists of one property: values (K,), one list after another, and their lengths (M,)."""

    values: npt.NDArray[np.generic]
    sizes: I64


Column = npt.NDArray[np.generic] | Ragged


def read_ply(data: bytes) -> Triangles:
    layout, elements, body = _header(data)
    if layout == "ascii":
        columns, rest = _ascii(data[body:], elements, data.count(b"\n", 0, body) or data.count(b"\r", 0, body))
    else:
        columns, rest = _binary(data, body, elements, "<" if layout == "binary_little_endian" else ">")
    vertices: F64 | None = None
    parts, notes = [], list(rest)
    for element, found in zip(elements, columns, strict=True):
        names = [p.name for p in element.properties]
        corners = next((found[names.index(name)] for name in CORNERS if name in names), None)
        if element.name == "vertex":
            missing = [axis for axis in "xyz" if axis not in names]
            if missing:
                raise UnreadableError(f"the vertex element has no property {missing[0]!r}")
            axes = [found[names.index(axis)] for axis in "xyz"]
            if any(isinstance(axis, Ragged) for axis in axes):
                raise UnreadableError("a coordinate of the vertex element is a list")
            vertices = np.stack(axes, axis=1).astype(np.float64)  # type: ignore[arg-type]
        elif element.name in ("face", "tristrips"):
            if element.rows and not isinstance(corners, Ragged):
                raise UnreadableError(f"the {element.name} element has no list named vertex_indices or vertex_index")
            if isinstance(corners, Ragged):
                parts.append((element.name, _indices(corners, element.name)))
        elif isinstance(corners, Ragged) and element.rows:
            raise UnreadableError(f"the element {shown(element.name)} names vertices, and is not read; export faces")
        elif element.rows:
            notes += [f"the element {shown(element.name)}, {element.rows} of them, was not read"]
    if vertices is None:
        raise UnreadableError("the header declares no vertex element")
    if not any(len(sizes) for _, (_, sizes) in parts):
        raise UnreadableError(f"holds no triangles: {len(vertices)} vertices and no faces (a point cloud?)")
    out = []
    for name, (values, sizes) in parts:
        if name == "face":
            starts = np.cumsum(sizes) - sizes
            check_indices(values, len(vertices), lambda k, s=starts: f"face {np.searchsorted(s, k, 'right') - 1}")  # type: ignore[misc]
            out.append(Triangles(vertices, *triangulate(vertices, values, sizes)))
        else:
            out.append(Triangles(vertices, _strips(values, sizes)))
    have = {p.name.lower() for element in elements for p in element.properties}
    lost = [name for name, marks in LOST.items() if have & marks]
    if len(out) == 1:
        return Triangles(vertices, out[0].faces, notes + out[0].notes, lost)
    both = joined(out)
    return Triangles(both.vertices, both.faces, notes + both.notes, lost)


def _indices(lists: Ragged, name: str) -> tuple[I64, I64]:
    values = lists.values.astype(np.float64) if lists.values.dtype.kind == "f" else lists.values
    if (
        values.dtype.kind == "f"
        and not (np.isfinite(values) & (values == np.rint(values)) & (abs(values) < 2**53)).all()
    ):
        raise UnreadableError(f"the {name} element names a vertex by a number that is not whole")
    return values.astype(np.int64), lists.sizes


def _strips(values: I64, sizes: I64) -> I64:
    """Make triangles of strips: every vertex after the second makes one with the two before it, every other one
    reversed. -1 begins a new strip."""
    out = []
    # Where lists begin, and where strips begin anew: a run of vertices goes from one such place to the next.
    new = np.flatnonzero((values == -1) | (values == 2**32 - 1))  # the latter is -1 in unsigned numbers
    places = np.unique(np.concatenate([[0], np.cumsum(sizes), new, new + 1])).tolist()
    for begin, end in itertools.pairwise(places):
        if end - begin > 2:
            out.append(strip_triangles(values[begin:end]))
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *out])


def strip_triangles(run: I64) -> I64:
    """Make triangles (n - 2, 3) of one strip of vertex numbers (n,)."""
    out = np.stack([run[:-2], run[1:-1], run[2:]], axis=1) if len(run) > 2 else np.empty((0, 3), dtype=np.int64)
    out[1::2] = out[1::2, [1, 0, 2]]
    return out


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """Parse the header: the layout's name, the elements, and the byte at which their data begins."""
    first = re.match(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r?\n|\r)", data)
    if not first:
        raise UnreadableError("does not begin with a line 'ply'")
    ending = first[1][-1:]  # a \r before the \n is white space
    layout, at = "", data.index(b"ply")
    elements: list[Element] = []
    for line_number in range(1, len(data) + 2):
        end = data.find(ending, at)
        if end < 0:
            raise UnreadableError("the header has no line 'end_header': the file is cut short, or is no PLY file")
        words, at = data[at:end].decode("latin-1").split(), end + len(ending)
        where = f"line {line_number}"
        if words == ["end_header"]:
            if not layout:
                raise UnreadableError("the header has no line 'format'")
            return layout, elements, at
        if words[:1] == ["format"] and len(words) == 3:
            layout = words[1]
            if layout not in ("ascii", "binary_little_endian", "binary_big_endian"):
                raise UnreadableError(f"{where}: the format {shown(layout)} is not known")
        elif words[:1] == ["element"] and len(words) == 3:
            rows = whole(words[2], where)
            if rows < 0 or any(e.name == words[1] for e in elements):
                raise UnreadableError(f"{where}: the element {shown(words[1])} is declared twice, or less than none")
            elements.append(Element(words[1], rows, []))
        elif words[:1] == ["property"] and elements and len(words) in (3, 5):
            elements[-1].properties.append(_property(words[1:], where))
        elif words and words[0] not in ("ply", "comment", "obj_info"):
            raise UnreadableError(f"{where}: {shown(' '.join(words))} is no line of a PLY header")
    raise AssertionError("a header has no more lines than the file has bytes")


def _property(words: list[str], where: str) -> Property:
    types, name = words[:-1], words[-1]
    kinds = [TYPES.get(t) for t in (types[1:] if len(types) == 3 else types)]
    if None in kinds or len(types) == 2 or (len(types) == 3 and (types[0] != "list" or kinds[0][:1] == "f")):  # type: ignore[index]
        raise UnreadableError(f"{where}: {shown(' '.join(types))} is no type of a property")
    return Property(name, str(kinds[-1]), str(kinds[0]) if len(kinds) == 2 else None)


# Binary.


def _binary(data: bytes, at: int, elements: list[Element], order: str) -> tuple[list[list[Column]], list[str]]:
    """Read the columns of every element, and make a note on what follows the last."""
    out = []
    for element in elements:
        found, alike = None, _alike(data, at, element, order)
        if alike is not None:
            found, size = _table(data, at, element, order, alike)
        if found is None:
            found, size = _rows(data, at, element, order)
        out.append(found)
        at += size
    rest = data[at:].strip()
    return out, [f"{len(rest)} bytes behind the last element were not read"] if rest else []


def _short(element: Element) -> UnreadableError:
    return UnreadableError(f"the file is cut short within its {element.rows} {shown(element.name)} elements")


def _alike(data: bytes, at: int, element: Element, order: str) -> list[int] | None:
    """Read the lengths of the first row's lists, which all rows may share; None where they are impossible."""
    sizes: list[int] = []
    if element.rows:
        for p in element.properties:
            if p.count is None:
                at += int(p.kind[1])
                continue
            width = int(p.count[1])
            if at + width > len(data):
                raise _short(element)
            sizes.append(int(np.frombuffer(data, order + p.count, 1, at)[0]))
            if not 0 <= sizes[-1] <= len(data) - at:
                return None
            at += width + sizes[-1] * int(p.kind[1])
    return sizes


def _table(data: bytes, at: int, element: Element, order: str, sizes: list[int]) -> tuple[list[Column] | None, int]:
    """Read the columns of an element whose rows all have lists of these lengths, or None when they have not; and its
    size in bytes."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    lengths = iter(sizes or [0] * len(element.lists))
    for k, p in enumerate(element.properties):
        if p.count is None:
            fields.append((f"v{k}", order + p.kind))
        else:
            fields += [(f"n{k}", order + p.count), (f"v{k}", order + p.kind, (next(lengths),))]
    row = np.dtype(fields)
    if element.rows and row.itemsize == 0:
        raise UnreadableError(f"the element {shown(element.name)} has no properties")
    total = element.rows * row.itemsize
    if at + total > len(data):
        if element.lists:
            return None, 0
        raise _short(element)
    table = np.frombuffer(data, row, element.rows, at)
    if any((table[f"n{k}"] != size).any() for k, size in zip(element.lists, sizes, strict=False)):
        return None, 0
    return [
        table[f"v{k}"]
        if p.count is None
        else Ragged(table[f"v{k}"].ravel(), np.full(element.rows, table.dtype[f"v{k}"].shape[0]))
        for k, p in enumerate(element.properties)
    ], total


def _rows(data: bytes, at: int, element: Element, order: str) -> tuple[list[Column], int]:
    """As `_table`, for lists of different lengths: finds one row after another."""
    begin, little = at, "little" if order == "<" else "big"
    plan = [(int(p.kind[1]), 0 if p.count is None else int(p.count[1])) for p in element.properties]
    starts: list[list[int]] = [[] for _ in plan]
    sizes: list[list[int]] = [[] for _ in plan]
    if element.rows * sum(max(count, 1) for _, count in plan) > len(data):
        raise _short(element)
    for _ in range(element.rows):
        for (width, count), start, size in zip(plan, starts, sizes, strict=True):
            # Read as unsigned, a length of -1 is too long for the file.
            n = int.from_bytes(data[at : at + count], little) if count else 1  # type: ignore[arg-type]
            at += count
            start.append(at)
            size.append(n)
            at += n * width
        if at > len(data):
            raise _short(element)
    raw = np.frombuffer(data, np.uint8)
    out: list[Column] = []
    for p, begins, lengths in zip(element.properties, starts, sizes, strict=True):
        kind = np.dtype(order + p.kind)
        many = np.array(lengths, dtype=np.int64)
        # The byte at which each number begins: the list's first byte plus the numbers before it.
        first = np.repeat(np.array(begins, dtype=np.int64) - kind.itemsize * (np.cumsum(many) - many), many)
        where = first + kind.itemsize * np.arange(many.sum())
        values = np.ascontiguousarray(raw[where[:, None] + np.arange(kind.itemsize)]).view(kind).ravel()
        out.append(values if p.count is None else Ragged(values, many))
    return out, at - begin


# ASCII.


def _ascii(data: bytes, elements: list[Element], before: int) -> tuple[list[list[Column]], list[str]]:
    """As `_binary`, for rows that are lines. before: how many lines the header has."""
    all_lines = lines_of(data, before)
    at = [k for k, line in enumerate(all_lines) if line and not line.isspace()]
    lines = all_lines if len(at) == len(all_lines) else [all_lines[k] for k in at]
    out, first = [], 0
    for element in elements:
        last = first + element.rows
        if last > len(lines):
            raise _short(element)
        found = _uniform(lines[first:last], element)
        if found is None:
            places = [before + at[k] + 1 for k in range(first, last)]
            found = _words(lines[first:last], element, places)
        out.append(found)
        first = last
    extra = len(lines) - first
    return out, left_out(extra, "lines behind the last element") if extra else []


def _uniform(lines: list[str], element: Element) -> list[Column] | None:
    """Read the columns of rows whose lists all have the same lengths, or return None."""
    table = numbers(lines)
    if table is None:
        return None
    out: list[Column] = []
    column = 0
    for p in element.properties:
        if column >= table.shape[1]:
            return None
        if p.count is None:
            out.append(table[:, column])
            column += 1
            continue
        size = float(table[0, column])
        if not (0 <= size < table.shape[1] and size == int(size) and (table[:, column] == size).all()):
            return None
        column += 1
        out.append(Ragged(table[:, column : column + int(size)].ravel(), np.full(len(lines), int(size))))
        column += int(size)
    return out if column == table.shape[1] else None


def _words(lines: list[str], element: Element, places: list[int]) -> list[Column]:
    """As `_uniform`, for lists of different lengths. Raises UnreadableError for faulty rows."""
    values: list[list[float]] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    for line, place in zip(lines, places, strict=True):
        words, k, where = line.split(), 0, f"line {place}"
        for p, value, size in zip(element.properties, values, sizes, strict=True):
            n = 1
            if p.count is not None and k < len(words):
                n = whole(words[k], where)
                k += 1
            if n < 0 or k + n > len(words):
                raise UnreadableError(
                    f"{where}: has {len(words)} numbers, fewer than the header asks of {shown(element.name)}"
                )
            value += [number(word, where) for word in words[k : k + n]]
            size.append(n)
            k += n
        if k < len(words):
            raise UnreadableError(
                f"{where}: has {len(words)} numbers, more than the header asks of {shown(element.name)}"
            )
    return [
        np.array(value) if p.count is None else Ragged(np.array(value), np.array(size, dtype=np.int64))
        for p, value, size in zip(element.properties, values, sizes, strict=True)
    ]
