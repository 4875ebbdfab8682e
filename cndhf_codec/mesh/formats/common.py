"""The result and the error of every reader, and the parsing of text that four of them share."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import F64, I64

# Most triangles of a file, counting copies of its parts: a few lines can ask for billions.
MOST_TRIANGLES = 2**27
MOST_COPIES = 2**17  # of a file's parts: instances, components, nodes with meshes


NO_NUMBER = re.compile(rb"-?[0-9]\.#(?:IND|QNAN|SNAN|INF)")


class UnreadableError(Exception):
    """Why a file is not read: where in it, what is wrong, the remedy. The file's name is put before it later."""


@dataclass
class Triangles:
    """Triangles that a reader has found.

    vertices: (N, 3) float64. faces: (M, 3) int64, not yet checked against N. notes: a line for the user about each
    thing in the file that was not read as it stands. lost: what else the file holds of the surface's looks or motion,
    by name.
    """

    vertices: F64
    faces: I64
    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def joined(parts: Sequence[Triangles]) -> Triangles:
    """Join parts in their order, with each distinct note once."""
    before = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Triangles(
        np.concatenate([np.empty((0, 3)), *(part.vertices for part in parts)]),
        np.concatenate(
            [np.empty((0, 3), dtype=np.int64), *(p.faces + n for p, n in zip(parts, before[:-1], strict=True))]
        ),
        list(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def check_indices(indices: I64, vertices: int, where: Callable[[int], str]) -> None:
    """Raise UnreadableError for the first of (K,) indices that names no vertex; where: the place of the k-th index."""
    bad = (indices < 0) | (indices >= vertices)
    if bad.any():
        k = int(bad.argmax())
        raise UnreadableError(f"{where(k)}: names vertex {indices[k]}, but there are {vertices}, counted from 0")


def check_count(triangles: int, vertices: int = 0, copies: int = 0) -> None:
    """Raise UnreadableError for more triangles, vertices or copies of its parts than a file may come to."""
    for count, most, what in (
        (triangles, MOST_TRIANGLES, "triangles"),
        (vertices, 3 * MOST_TRIANGLES, "vertices"),
        (copies, MOST_COPIES, "copies of its parts"),
    ):
        if count > most:
            raise UnreadableError(f"comes to {count} {what}; at most {most} are read")


def lines_of(data: bytes, before: int = 0) -> list[str]:
    """Split a text file into lines, whatever ends them, without a byte order mark. before: lines that precede them."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise UnreadableError("is UTF-16 text; save it as UTF-8 or ASCII")
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    zero = data.find(b"\0")
    if zero >= 0:
        line = before + data.count(b"\n", 0, zero) + 1
        raise UnreadableError(f"line {line}: holds a zero byte, so this is no text, or the file is damaged")
    # Microsoft's C library writes NaN and infinity like this; what follows the # would be taken for a comment.
    if found := NO_NUMBER.search(data) if b".#" in data else None:
        line = before + data.count(b"\n", 0, found.start()) + 1
        raise UnreadableError(f"line {line}: {shown(found[0].decode())} is no number")
    return data.decode("latin-1").split("\n")  # names may be in any alphabet: this never fails


def numbers(lines: Sequence[str], comments: str | None = None) -> F64 | None:
    """Read numbers (lines, columns), or None where lines hold different counts or a word is no number."""
    if not lines or not lines[0].partition(comments or "\n")[0].strip():  # numpy warns of nothing but blank lines
        return None
    try:
        found = np.loadtxt(lines, dtype=np.float64, comments=comments, ndmin=2)
    except ValueError:
        return None
    return found if len(found) == len(lines) else None  # blank lines are skipped


def number(word: str, where: str) -> float:
    """Parse a decimal number. Raises UnreadableError, which names the place and a likely reason."""
    try:
        if "_" not in word:
            return float(word)
    except ValueError:
        pass
    hint = "; write decimals with a point, not a comma" if "," in word else ""
    raise UnreadableError(f"{where}: {shown(word)} is no number{hint}")


def whole(word: str, where: str) -> int:
    """Parse a whole number of at most 18 digits. Raises UnreadableError."""
    digits = word.removeprefix("-").removeprefix("+")
    if not (digits.isascii() and digits.isdigit() and len(digits) <= 18):
        raise UnreadableError(f"{where}: {shown(word)} is no whole number")
    return int(word)


def shown(word: str, most: int = 40) -> str:
    """Make a word of a file fit for a message: quoted, short, without control characters."""
    return ascii(word if len(word) <= most else word[: most - 3] + "...")


def told(value: object) -> str:
    """Make a JSON value fit for a message. Lists and objects are not written out: they may be nested too deeply."""
    if isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "an object"
    return shown(value if isinstance(value, str) else repr(value))


def left_out(count: int, what: str) -> list[str]:
    """Make a note on what was left out, if anything was."""
    return [f"{count} {what} {'was' if count == 1 else 'were'} left out"] if count else []
