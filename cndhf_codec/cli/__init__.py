"""The console scripts. One module per command; this one turns every failure into one line and an exit code.

Exit codes: 0 done, 1 failed (the line says why) or refused by --check, 2 wrong arguments, 130 interrupted.
"""

from __future__ import annotations

import importlib
import io
import sys
import warnings
from functools import partial
from typing import Any

from ..encoder.progress import CLEAR
from ..errors import CndhfError, CndhfWarning, OptionError, require
from .terminal import wrapped


def encode() -> None:
    """Run `cndhf-encode`."""
    sys.exit(_run("encode"))


def decode() -> None:
    """Run `cndhf-decode`."""
    sys.exit(_run("decode"))


def info() -> None:
    """Run `cndhf-info`."""
    sys.exit(_run("info"))


def compare() -> None:
    """Run `cndhf-compare`."""
    sys.exit(_run("compare"))


def view() -> None:
    """Run `cndhf-view`."""
    sys.exit(_run("view"))


def batch() -> None:
    """Run `cndhf-batch`."""
    sys.exit(_run("batch"))


def _run(name: str) -> int:
    program = f"cndhf-{name}"
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Do not fail at the end because the terminal's encoding lacks a character of a file name.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        extra = {
            "encode": "encode",
            "decode": "mesh",
            "info": "cli",
            "compare": "compare",
            "view": "cli",
            "batch": "encode",
        }[name]
        click = require("click", extra)
    except CndhfError as exc:
        return _fail(program, str(exc), 1)
    # The first import of a submodule binds it to its name in this package, over the console script: put that back.
    script = globals()[name]
    command = importlib.import_module(f".{name}", __name__).command
    globals()[name] = script
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", CndhfWarning)
            warnings.showwarning = partial(_show_warning, program)
            return int(command.main(prog_name=program, standalone_mode=False) or 0)
    except click.ClickException as exc:
        return _fail(program, f"{exc.format_message()} (see {program} --help)", exc.exit_code)
    except OptionError as exc:
        return _fail(program, f"{exc} (see {program} --help)", 2)
    except CndhfError as exc:
        return _fail(program, str(exc), 1)
    except OSError as exc:  # from printing the summary: files have errors of their own
        return _fail(program, exc.strerror or str(exc), 1)
    except (KeyboardInterrupt, click.Abort):
        return _fail(program, "interrupted; nothing was written", 130)
    except MemoryError:
        return _fail(program, "out of memory; use a smaller mesh or a lower --resolution", 1)


def _show_warning(program: str, message: Warning | str, category: type[Warning], *place: Any, **_: Any) -> None:
    """Print this package's warnings as one line, and all others as Python does."""
    if issubclass(category, CndhfWarning):
        text = wrapped(f"{program}: warning: {' '.join(str(message).split())}\n", sys.stderr)
        if sys.stderr.isatty():
            text = f"{CLEAR}{text}"  # a progress bar may stand there
    else:
        text = warnings.formatwarning(message, category, *place[:2])
    sys.stderr.write(text)


def _fail(program: str, message: str, code: int) -> int:
    one_line = " ".join(message.split())
    sys.stderr.write(wrapped(f"{program}: error: {one_line}\n", sys.stderr))
    return code
