"""`cndhf-info`: what a .cndhf file holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click


@click.command()
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.version_option(package_name="cndhf-codec")
def command(source: Path, as_json: bool) -> None:
    """Print what INPUT.cndhf holds: size, double height fields, measured error in input units."""
    from ..decoder.model import load

    info = load(source).info
    click.echo(json.dumps(info, indent=2) if as_json else _table(source, info))


def _table(source: Path, info: dict[str, Any]) -> str:
    lines = [
        f"{source}: {info['bytes']} bytes, {info['parameters']} parameters, "
        f"{info['bits_per_parameter']:.2f} bits a parameter",
        f"centre {info['centre']}, scale {info['scale']:g}",
    ]
    for i, dhf in enumerate(info["dhfs"]):
        lines.append(
            f"DHF {i}: axis {dhf['axis']}, width {dhf['width']}, {dhf['hidden_layers']} hidden layers, "
            f"{dhf['parameters']} parameters"
        )
    if info["mean_error"] is not None:
        lines.append(
            f"measured error, input units: mean {info['mean_error']:.4g}, p99 {info['p99_error']:.4g}, "
            f"maximum {info['max_error']:.4g}"
        )
    if info["encoder"] is not None:
        lines.append(f"written by {_printable(info['encoder'])}")
    if info["source"] is not None:
        lines.append(f"source {_printable(info['source'])}")
    return "\n".join(lines)


def _printable(text: str) -> str:
    """Text from a file, which may come from anyone, without what would move a terminal's cursor."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
