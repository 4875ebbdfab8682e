"""`cndhf-info`: print what a .cndhf file holds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from .streams import read_input
from .terminal import say


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.version_option(package_name="cndhf-codec")
def command(source: Path, as_json: bool) -> None:
    """Print what INPUT.cndhf holds: bytes by section, its fields or its surface, measured error in input units.

    INPUT may be `-`, the standard input.
    """
    from ..decoder.reading import load_bytes

    data, name = read_input(source)
    info = load_bytes(data, name).info
    say(json.dumps(info, indent=2) if as_json else _table(name, info))


def _table(source: str, info: dict[str, Any]) -> str:
    rows = [(name, f"{n}", f"{100 * n / info['bytes']:.1f} %") for name, n in info["sections"].items()]
    lines = [
        f"{source}: {info['bytes']} bytes",
        "",
        *_columns([("section", "bytes", "share"), *rows]),
        "",
        *(_surface(info) if info["representation"] == "surface" else _height_fields(info)),
    ]
    lines += ["", "centre " + " ".join(f"{x:g}" for x in info["centre"]) + f", scale {info['scale']:g}"]
    if info["mean_error"] is not None:
        lines.append(
            f"measured error, input units: mean {info['mean_error']:.4g}, p99 {info['p99_error']:.4g}, "
            f"maximum {info['max_error']:.4g}"
        )
    else:
        lines.append("error not measured")
    if info["encoder"] is not None:
        lines.append(f"encoder {_printable(info['encoder'])}")
    if info["source"] is not None:
        lines.append(f"source {_printable(info['source'])}")
    return "\n".join(lines)


def _height_fields(info: dict[str, Any]) -> list[str]:
    fields = [
        (
            str(i),
            " ".join(f"{x:+.3f}" for x in dhf["axis"]),
            "".join(dhf["mirrored"]) or "-",
            str(dhf["width"]),
            str(dhf["hidden_layers"]),
            str(dhf["parameters"]),
        )
        for i, dhf in enumerate(info["dhfs"])
    ]
    return [
        f"{info['parameters']} weights, {8 * info['sections']['weights'] / info['parameters']:.2f} bits each "
        f"({info['bits_per_parameter']:.2f} of the whole file)",
        "",
        *_columns([("field", "axis", "mirror", "width", "layers", "weights"), *fields]),
    ]


def _surface(info: dict[str, Any]) -> list[str]:
    return [
        f"surface of {info['components']} component{'s' * (info['components'] != 1)}, "
        f"{'closed' if info['closed'] else 'open: a sheet'}",
        f"control mesh: {info['vertices']} vertices, {info['faces']} faces, {info['sharp_edges']} sharp edges, "
        f"{8 * info['sections']['surface'] / max(info['vertices'], 1):.2f} bits per vertex "
        f"({info['bits_per_vertex']:.2f} of the whole file)",
    ]


def _columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Align the first column left and the others right, two spaces apart."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]


def _printable(text: str) -> str:
    """Replace what would move a terminal's cursor: the text of a file may come from anyone."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
