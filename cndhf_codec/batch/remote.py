"""Files named by URLs (s3://, gs://, zip://, ...), by way of fsspec."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError, OptionError, OutputError, first_line, require
from ..files import PIECE


def is_url(place: str) -> bool:
    return "://" in place


def join(place: str, name: str) -> str:
    """A path or URL of something below a folder; `name` has slashes."""
    if not is_url(place):
        return str(Path(place, *name.split("/")))
    head, mark, tail = place.partition("::")  # a chain of file systems: the first has the name
    below = head if head.endswith("://") else f"{head.rstrip('/')}/"
    return f"{below}{name}{mark}{tail}"


def beside(url: str, name: str) -> str:
    """URL of a file in the folder of another."""
    head, mark, tail = url.partition("::")
    return f"{head.rpartition('/')[0]}/{name}{mark}{tail}"


def stamps(url: str) -> Iterator[tuple[str, str]]:
    """Yield the names of all files below a folder, with slashes, and their stamps. Raises InputError."""
    for name, about in _below(url, InputError):
        yield name, _stamp(about)


def sizes(url: str) -> dict[str, int]:
    """Bytes of all files below a folder, by name; none where it is not there yet. Raises OutputError."""
    return {name: int(about["size"]) for name, about in _below(url, OutputError)}


def fetch(url: str, folder: Path) -> Path:
    """Copy a file into a folder, under its own name. Raises InputError."""
    system, path = _system(url, InputError)
    target = folder / (posixpath.basename(path) or "mesh")
    try:
        with system.open(path, "rb") as source, open(target, "wb") as copy:
            while piece := source.read(PIECE):
                copy.write(piece)
    except Exception as exc:
        raise _error(url, "read", exc, InputError) from exc
    return target


def store(url: str, data: bytes) -> None:
    """Write a file. Object stores show it whole or not at all. Raises OutputError."""
    system, path = _system(url, OutputError)
    try:
        system.makedirs(posixpath.dirname(path), exist_ok=True)
        system.pipe_file(path, data)
    except Exception as exc:
        raise _error(url, "written", exc, OutputError) from exc


def _below(url: str, kind: type[InputError | OutputError]) -> Iterator[tuple[str, dict[str, Any]]]:
    system, root = _system(url, kind)
    try:
        if not system.isdir(root):
            if kind is OutputError:
                return
            raise InputError(f"{url}: is no folder; name one, or encode a single file with cndhf-encode")
        found = system.find(root, detail=True)
    except Exception as exc:
        raise _error(url, "read", exc, kind) from exc
    for path, about in found.items():
        yield posixpath.relpath("/" + path.lstrip("/"), "/" + root.strip("/")), about


def _system(url: str, kind: type[InputError | OutputError]) -> tuple[Any, str]:
    core = require("fsspec.core", "cluster")
    try:
        system, path = core.url_to_fs(url)
    except ValueError as exc:  # an unknown protocol
        raise OptionError(f"{url}: {first_line(exc)}") from exc
    except Exception as exc:  # a library of the protocol is not installed, no permission: every system has its own
        raise _error(url, "opened", exc, kind) from exc
    return system, path


def _stamp(about: dict[str, Any]) -> str:
    """What changes with a file's content, as the file system tells it; "" where it tells nothing."""
    for key in ("ETag", "etag", "md5Hash", "mtime", "LastModified", "updated", "last_modified"):
        if about.get(key):
            return f"{about.get('size')} {about[key]}"
    return ""


def _error(url: str, what: str, exc: Exception, kind: type[InputError | OutputError]) -> InputError | OutputError:
    if isinstance(exc, (InputError, OutputError)):
        return exc
    return kind(f"{url}: cannot be {what}: {first_line(exc)}")
