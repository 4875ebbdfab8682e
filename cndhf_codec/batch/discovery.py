"""Find the meshes below a folder, and name their outputs."""

from __future__ import annotations

import os
import stat
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from ..errors import InputError
from ..mesh.read import EXTENSIONS, PACKED
from . import remote

# Evidence for this constant: ADR 042.
TICK = 2.0  # seconds; the coarsest clock of a common file system, FAT's


@dataclass(frozen=True)
class Found:
    """A mesh. name: its path below the folder, with slashes. source: its path or URL. output: the path of its .cndhf
    file below OUT. stamp: changes when the file does; "" where that cannot be told."""

    name: str
    source: str
    output: str
    stamp: str


@dataclass(frozen=True)
class Listing:
    """Meshes, sorted by name; and what is none although its name says so, with the reason."""

    files: list[Found]
    refused: list[tuple[str, str]]


def find(root: str, include: Sequence[str] = ()) -> Listing:
    """Find the meshes below a folder, by the extensions of their names.

    Names that begin with a dot are passed over, and links to folders are not followed. include: patterns, of which one
    has to match the path below the folder, or the name alone where the pattern has no slash; none is all. Raises
    InputError.
    """
    pairs, refused = [], []
    for name, stamp, reason in _remote(root) if remote.is_url(root) else _local(root):
        if name.endswith("/"):  # a folder
            refused.append((name, reason))
        elif _wanted(name, include):
            printable = name.encode("utf-8", "backslashreplace").decode()
            if reason or printable != name:
                refused.append((printable, reason or "its name is not UTF-8; rename it"))
            else:
                pairs.append((name, stamp))
    pairs.sort()
    outputs = output_names([name for name, _ in pairs])
    files = [Found(name, remote.join(root, name), outputs[name], stamp) for name, stamp in pairs]
    return Listing(files, sorted(refused))


def output_names(names: Sequence[str]) -> dict[str, str]:
    """Name the output of each input: a/b.ply becomes a/b.cndhf. Where inputs would have one output, all of them keep
    their extension: b.obj and b.ply become b.obj.cndhf and b.ply.cndhf."""
    short = {name: f"{_stem(name)}.cndhf" for name in names}
    # Some file systems take B.cndhf and b.cndhf for one. A whole name may be another's short one: b.ply.obj.
    while True:
        count = Counter(output.casefold() for output in short.values())
        longer = [n for n, o in short.items() if count[o.casefold()] > 1 and o != f"{n}.cndhf"]
        if not longer:
            return short
        short |= {name: f"{name}.cndhf" for name in longer}


def stamp_of(status: os.stat_result) -> str:
    """Size and time of a file; "" while it is so new that a change might not move the clock."""
    if time.time() - status.st_mtime < TICK:
        return ""
    return f"{status.st_size} {status.st_mtime_ns}"


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    if path.suffix.lower() in PACKED.values():
        path = path.with_suffix("")
    return str(path.with_suffix(""))


def _wanted(name: str, include: Sequence[str]) -> bool:
    path = PurePosixPath(name)
    kind = PurePosixPath(path.stem).suffix if path.suffix.lower() in PACKED.values() else path.suffix
    if kind.lower() not in EXTENSIONS or any(part.startswith(".") for part in path.parts):
        return False
    return not include or any(fnmatchcase(name if "/" in glob else path.name, glob) for glob in include)


def _remote(root: str) -> Iterator[tuple[str, str, str]]:
    for name, stamp in remote.stamps(root):
        yield name, _of_kind(name, stamp), ""


def _local(root: str) -> Iterator[tuple[str, str, str]]:
    """Name, stamp, and the reason where it is refused; the name of a folder ends in a slash."""
    if not os.path.isdir(root):
        what = "is no folder; encode a single file with cndhf-encode" if os.path.exists(root) else "no such folder"
        raise InputError(f"{root}: {what}")
    unread: list[OSError] = []
    for folder, folders, names in os.walk(root, onerror=unread.append):
        folders[:] = sorted(f for f in folders if not f.startswith("."))
        below = Path(folder).relative_to(root)
        for name in names:
            path = (below / name).as_posix()
            try:
                status = os.stat(os.path.join(folder, name))
            except OSError as exc:  # a link to nothing
                yield path, "", f"cannot be read: {exc.strerror}"
                continue
            if stat.S_ISREG(status.st_mode):
                yield path, _of_kind(path, stamp_of(status)), ""
            else:
                yield path, "", f"is {_what(status.st_mode)}, which is not read"
    for error in unread:
        if str(error.filename) == root:
            raise InputError(f"{root}: cannot be read: {error.strerror}")
        yield f"{Path(error.filename).relative_to(root).as_posix()}/", "", f"cannot be read: {error.strerror}"


def _of_kind(name: str, stamp: str) -> str:
    """The stamp of a file that names others says nothing about those."""
    return "" if ".gltf" in PurePosixPath(name.lower()).suffixes else stamp


def _what(mode: int) -> str:
    if stat.S_ISFIFO(mode):
        return "a pipe"
    if stat.S_ISSOCK(mode):
        return "a socket"
    return "a device"
