"""`cndhf-compare`: how far two shapes are from each other."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..errors import require
from ..files import check_output, write_atomically
from .terminal import say


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("a", metavar="A", type=click.Path(path_type=Path))
@click.argument("b", metavar="B", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option(
    "--html",
    metavar="REPORT.html",
    type=click.Path(path_type=Path),
    help="Write a page with pictures of both and of the error.",
)
@click.option("--up", type=click.Choice(["y", "z"]), default="y", help="Which axis points up in the pictures.")
@click.option("--resolution", type=int, help="Of double height fields, as in cndhf-decode.  [default: 384]")
@click.option("--overwrite", is_flag=True, help="Replace REPORT.html if it exists.")
@click.version_option(package_name="cndhf-codec")
def command(
    a: Path, b: Path, as_json: bool, html: Path | None, up: str, resolution: int | None, overwrite: bool
) -> None:
    """Measure the distances between the surfaces A and B: meshes (OBJ, PLY, STL, OFF, GLB, glTF, 3MF) or .cndhf files.

    In input units, and in percent of the diagonal of A's bounding box, so A should be the original. The mean error (CD)
    is the mean of the two directed mean distances; p99 and maximum are of 200,000 points on each surface.
    """
    from ..report.compare import compare, read_shape

    if html is not None:
        check_output(html, overwrite, [a, b])
        require("matplotlib", "report")  # a comparison takes long: first say what is missing
    result = compare(read_shape(a, resolution), read_shape(b, resolution))
    for path, shape in ((a, result.a), (b, result.b)):
        for note in shape.notes:
            say(f"cndhf-compare: warning: {path}: {note}", err=True)
    if html is not None:
        from ..report.page import page

        write_atomically(html, page(result, up).encode(), overwrite)
    values = result.as_dict()
    if as_json:
        click.echo(json.dumps(values, indent=2))
        return
    say(f"{a} ({result.a.bytes} bytes) and {b} ({result.b.bytes} bytes), diagonal {result.diagonal:.4g}")
    for key, name in (("mean_error", "mean"), ("p99_error", "p99"), ("max_error", "maximum")):
        click.echo(f"{name:<10}{values[key]:<12.4g}{values['percent'][key]:.4f} %")
