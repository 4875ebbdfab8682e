"""Lines for people: on a terminal they end between words; elsewhere each stays whole, for programs."""

from __future__ import annotations

import shutil
import sys
import textwrap
from typing import TextIO

LEAST_COLUMNS = 20


def say(text: str, err: bool = False) -> None:
    """Print lines on the standard output, or error."""
    import click

    click.echo(wrapped(text, sys.stderr if err else sys.stdout), err=err)


def wrapped(text: str, stream: TextIO | None) -> str:
    """Break lines that are wider than the terminal, if the stream is one. Those of tables stay."""
    if stream is None or not stream.isatty():
        return text
    columns = max(shutil.get_terminal_size((80, 24)).columns, LEAST_COLUMNS)

    def broken(line: str) -> str:
        if len(line) <= columns or "  " in line:
            return line
        return textwrap.fill(line, columns, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)

    return "\n".join(broken(line) for line in text.split("\n"))
