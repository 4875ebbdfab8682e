"""docs/cli.md from the commands' own help: `python tools/docs/cli_reference.py`.

With --check nothing is written, and the exit code is 1 when the file is out of date.
"""

from __future__ import annotations

import importlib
import sys
import textwrap
from pathlib import Path

import click

TARGET = Path(__file__).resolve().parents[2] / "docs" / "cli.md"
COMMANDS = ("encode", "decode", "info", "compare", "view", "batch")
ELSEWHERE = ("version", "help")  # options that every command has; said once, above
INTRODUCTION = """\
# Commands

The options of all commands, written by `tools/docs/cli_reference.py` from the commands' own help. Do not edit.

Every command has `--help` (`-h`) and `--version`. INPUT and OUTPUT are files; `-` is the standard input or output where
a command says so. Sizes are bytes, such as 4096, 4KB or 4KiB. Lengths are a share of the diagonal of the bounding box
(`0.2%`), a number in input units, or, with `--unit`, a length such as `0.5mm`.

**Exit codes**: 0 done, 1 failed or refused by `--check` (one line says why), 2 wrong arguments, 130 interrupted.
Outputs are written whole or not at all; none replaces an input or a device, and an existing one only with
`--overwrite`. Warnings, files and what a run leaves behind: [usage.md](usage.md).
"""


def reference() -> str:
    """The whole file."""
    return "\n".join([INTRODUCTION, *map(_section, COMMANDS)])


def _section(name: str) -> str:
    command = importlib.import_module(f"cndhf_codec.cli.{name}").command
    arguments = " ".join(p.metavar or str(p.name).upper() for p in command.params if isinstance(p, click.Argument))
    options = [p for p in command.params if isinstance(p, click.Option) and p.name not in ELSEWHERE and not p.hidden]
    rows = [_row(option) for option in options]
    return "\n".join(
        [
            f"## cndhf-{name}",
            "",
            f"`cndhf-{name} [OPTIONS] {arguments}`",
            "",
            _paragraphs(command.help or ""),
            "",
            "| option | default | meaning |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )


def _row(option: click.Option) -> str:
    names = ", ".join((*option.opts, *option.secondary_opts))
    if not option.is_flag:
        choices = isinstance(option.type, click.Choice)
        # Braces or brackets around choices differ between versions of click.
        names += " " + ("|".join(map(str, option.type.choices)) if choices else _metavar(option))
    text, default = option.help or "", _default(option)
    # Defaults that the help itself states, such as those that a preset decides.
    head, mark, tail = text.partition("[default: ")
    if mark:
        text, default = head, tail.rstrip().rstrip("]")
    return f"| `{_escaped(names)}` | {_escaped(default)} | {_escaped(' '.join(text.split()))} |"


def _metavar(option: click.Option) -> str:
    if option.metavar:
        return option.metavar
    kind = option.type
    if isinstance(kind, (click.IntRange, click.FloatRange)) or kind in (click.INT, click.FLOAT):
        limits = [str(bound) for bound in (getattr(kind, "min", None), getattr(kind, "max", None)) if bound is not None]
        return "N" + (f" ({' to '.join(limits)})" if len(limits) == 2 else "")
    return kind.name.upper()


def _default(option: click.Option) -> str:
    if option.is_flag:
        return "off"
    default = option.default
    # Newer versions of click have a mark of their own for an option without a default.
    return str(default) if isinstance(default, (str, int, float)) and not callable(default) else ""


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")


def _paragraphs(text: str) -> str:
    return "\n\n".join(textwrap.fill(" ".join(part.split()), 120) for part in text.replace("\b", "").split("\n\n"))


@click.command()
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 when the file is out of date.")
def main(check: bool) -> None:
    """Write docs/cli.md."""
    text = reference()
    if not check:
        TARGET.write_text(text, encoding="utf-8", newline="\n")
    elif not TARGET.exists() or TARGET.read_text(encoding="utf-8") != text:
        click.echo(f"{TARGET.name} is out of date: run python tools/docs/cli_reference.py", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
