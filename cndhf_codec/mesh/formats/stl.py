"""Read STL. A file is binary when it is as long as its count of triangles says, whatever it begins with; else ASCII."""

from __future__ import annotations

import re

import numpy as np

from ...arrays import F64
from .common import Triangles, UnreadableError, number, shown

HEADER, RECORD = 84, 50
ENOUGH = 2**12  # first bytes, which tell ASCII from binary
COORDINATES = rb"\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)"
FACET = re.compile(
    rb"\s*facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop" + 3 * COORDINATES + rb"\s+endloop\s+endfacet(?!\S)",
    re.IGNORECASE,
)
# A name may hold any words: it ends with its line.
BEGIN, END = (
    re.compile(rb"\s*solid(?!\S)[^\r\n]*", re.IGNORECASE),
    re.compile(rb"\s*endsolid(?!\S)[^\r\n]*", re.IGNORECASE),
)


def is_binary(data: bytes) -> bool:
    """Whether the length of the bytes agrees with the count of triangles in them."""
    return len(data) >= HEADER and len(data) == HEADER + RECORD * _count(data)


def is_ascii(data: bytes) -> bool:
    """Whether the bytes are text that begins as facets do."""
    text = _text(data[:ENOUGH])
    begin = BEGIN.match(text)
    if not begin or b"\0" in text:  # a binary file may begin with any words, but not go on without zeros
        return False
    rest = text[begin.end() :].split(None, 1)
    return not rest or rest[0].lower() in (b"facet", b"endsolid")


def read_stl(data: bytes) -> Triangles:
    if is_binary(data):
        return _binary(data)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise UnreadableError("is UTF-16 text; save it as UTF-8 or ASCII")
    start = _text(data[:ENOUGH])
    if is_ascii(data) or (b"\0" not in start and re.search(rb"\bfacet\b", start, re.IGNORECASE)):
        return _ascii(_text(data))
    return _binary(data)


def _text(data: bytes) -> bytes:
    """Remove a byte order mark, and what old programs end a text with."""
    return data.removeprefix(b"\xef\xbb\xbf").rstrip(b"\0\x1a \t\r\n")


def _count(data: bytes) -> int:
    return int.from_bytes(data[80:84], "little")


def _binary(data: bytes) -> Triangles:
    if len(data) < HEADER:
        raise UnreadableError(
            f"has {len(data)} bytes; a binary STL file has {HEADER} and more, an ASCII one begins 'solid'"
        )
    count, room = _count(data), (len(data) - HEADER) // RECORD
    if count > room or (count == 0 and room > 0):
        raise UnreadableError(
            f"the header says {count} triangles, the file has room for {room}: "
            "it is cut short or damaged, or no STL file"
        )
    if count == 0:
        raise UnreadableError("holds no triangles: the header says 0")
    table = np.frombuffer(data, [("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")], count, HEADER)
    rest = data[HEADER + RECORD * count :]
    notes = []
    if rest.strip():
        notes.append(
            f"the header says {count} triangles, the file has room for {room}: "
            f"{len(rest)} bytes behind them were not read"
        )
    return _soup(table["corners"].reshape(-1, 3).astype(np.float64), notes)


def _soup(corners: F64, notes: list[str]) -> Triangles:
    return Triangles(corners, np.arange(len(corners)).reshape(-1, 3), notes)


def _ascii(data: bytes) -> Triangles:
    """Read solids one after another: `solid NAME`, facets, `endsolid NAME`."""
    words: list[bytes] = []
    starts: list[int] = []
    notes: list[str] = []
    at, inside, ended = 0, False, 0
    while True:
        if inside:
            while facet := FACET.match(data, at):
                words += facet.groups()
                starts.append(at)
                at = facet.end()
            if end := END.match(data, at):
                at, inside, ended = end.end(), False, ended + 1
                continue
        elif begin := BEGIN.match(data, at):
            at, inside = begin.end(), True
            continue
        rest = data[at:].split(None, 4)
        if not rest:
            break
        raise _out_of_place(data, at, rest, inside)
    if inside and ended:
        raise UnreadableError(
            f"the file is cut short: its last solid has no line 'endsolid', as the {ended} before it have"
        )
    if inside:
        notes.append("there is no line 'endsolid' at the end: the file may be cut short")
    if not words:
        raise UnreadableError("holds no triangles: a solid without facets")
    try:
        if b"_" in data and any(b"_" in word for word in words):
            raise ValueError("Python reads 1_0 as 10")
        corners = np.array(words, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        corners = np.array([_number(word, data, starts[k // 9]) for k, word in enumerate(words)]).reshape(-1, 3)
    return _soup(corners, notes)


def _number(word: bytes, data: bytes, at: int) -> float:
    """As `number`; the line of the facet at this byte is found only for an error, since that takes long."""
    try:
        return number(word.decode("latin-1"), "")
    except UnreadableError:
        return number(word.decode("latin-1"), f"line {_line(data, at)}")


def _line(data: bytes, at: int) -> int:
    """The number of the line that holds the next word."""
    at += len(data[at:]) - len(data[at:].lstrip())
    before = data[:at].replace(b"\r\n", b"\n")
    return before.count(b"\n") + before.count(b"\r") + 1


def _out_of_place(data: bytes, at: int, rest: list[bytes], inside: bool) -> UnreadableError:
    """Make the error for a word in a wrong place: neither a facet nor the end of a solid, or between solids."""
    line, word = _line(data, at), rest[0].decode("latin-1")
    if word.lower() == "facet" and b"endfacet" not in data[at:].lower():
        return UnreadableError(f"line {line}: the file is cut short within a facet")
    if word.lower() == "facet":
        return UnreadableError(
            f"line {line}: a facet is 'facet normal', 'outer loop', three of 'vertex', 'endloop', 'endfacet'"
        )
    expected = "'facet' or 'endsolid'" if inside else "'solid'"
    return UnreadableError(f"line {line}: {shown(word)} where {expected} should stand")
