"""The standard input and output as INPUT and OUTPUT of a command."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError, OptionError
from ..files import STREAM, read_bytes
from ..format.constants import MAX_FILE_SIZE


def standard_input() -> BinaryIO:
    """Raises InputError where it is closed."""
    if sys.stdin is None:
        raise InputError("the standard input is closed; name a file")
    return sys.stdin.buffer


def read_input(source: Path) -> tuple[bytes, str]:
    """The bytes of a .cndhf file, up to one more than the format allows, and its name in errors. Raises InputError."""
    if source != STREAM:
        return read_bytes(source, MAX_FILE_SIZE + 1), str(source)
    try:
        return standard_input().read(MAX_FILE_SIZE + 1), "standard input"
    except OSError as exc:
        raise InputError(f"standard input: cannot be read: {exc.strerror}") from exc


def check_standard_output() -> None:
    """Raise OptionError, before any work is done, where bytes cannot go to the standard output."""
    if sys.stdout is None or sys.stdout.isatty():
        raise OptionError("OUTPUT is - and the standard output is closed or a terminal: send it to a file or a program")
