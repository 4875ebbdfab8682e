"""The standard input and output as INPUT and OUTPUT of a command."""

from __future__ import annotations

import sys
from typing import BinaryIO

from ..errors import InputError, OptionError


def standard_input() -> BinaryIO:
    """Raises InputError where it is closed."""
    if sys.stdin is None:
        raise InputError("the standard input is closed; name a file")
    return sys.stdin.buffer


def check_standard_output() -> None:
    """Raise OptionError, before any work is done, where bytes cannot go to the standard output."""
    if sys.stdout is None or sys.stdout.isatty():
        raise OptionError("OUTPUT is - and the standard output is closed or a terminal: send it to a file or a program")
