"""`cndhf-encode`: encode a mesh file to a .cndhf file, or check what would become of the mesh."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from ..errors import OptionError
from ..files import STREAM, check_output
from .streams import check_standard_output, standard_input

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..decoder.model import Model
    from ..encoder.check import Check
    from ..encoder.report import Other, Report
    from ..encoder.settings import Preset, Representation
    from ..mesh.bodies import Bodies


@click.command(context_settings={"show_default": True})
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUTPUT.cndhf", required=False, type=click.Path(path_type=Path))
@click.option(
    "--check", "only_check", is_flag=True, help="Say what INPUT is like and what would become of it; no OUTPUT."
)
@click.option("--json", "as_json", is_flag=True, help="With --check: print one JSON object.")
@click.option(
    "--preset",
    type=click.Choice(["fast", "default", "best", "paper"]),
    default="default",
    help="How much work to spend; `paper` is the published method, for comparison.",
)
@click.option(
    "--representation",
    type=click.Choice(["auto", "dhf", "surface"]),
    default="auto",
    help="dhf: a solid as double height fields; takes minutes. surface: the surface as it is given, open or closed, "
    "with its inner parts, as a subdivision surface; takes seconds. auto: the better one; --preset fast makes surfaces "
    "alone, default tries height fields where they may win, best makes both.",
)
@click.option("--axes", type=int, help="Use at most this many double height fields (dhf).  [default: the preset's]")
@click.option("--width", type=int, help="Neurons in each layer of the networks (dhf).  [default: the preset's]")
@click.option(
    "--target-size",
    metavar="SIZE",
    help="Most bytes of OUTPUT, such as 4096, 4KB or 4KiB.  [default: the preset's]",
)
@click.option(
    "--target-error",
    metavar="ERROR",
    help="Most mean error: 0.2% of the bounding box's diagonal, a number in input units, or 0.5mm with --unit. "
    "Makes the smallest file found that keeps to it, by several encodes.",
)
@click.option(
    "--unit",
    type=click.Choice(["mm", "cm", "m", "in"]),
    help="What the input's unit is, for --target-error and --thicken.",
)
@click.option(
    "--thicken",
    metavar="THICKNESS",
    help="Give open sheets, which have no inside, a wall: 1% of the bounding box's diagonal, a number in input units, "
    "or 2mm with --unit.",
)
@click.option(
    "--steps",
    type=int,
    help="With --preset paper: steps of the fit of each field; the paper's are a million.  [default: 5000]",
)
@click.option(
    "--time-limit",
    metavar="SECONDS",
    type=float,
    help="Cut the fit short to keep to it; equal seeds then no longer give equal bytes.",
)
@click.option("--seed", type=int, default=0, help="Equal seeds give equal bytes on one kind of machine.")
@click.option("--threads", type=int, help="Threads to use.  [default: all]")
@click.option("--source-name", is_flag=True, help="Write the input's file name into the output.")
@click.option("--overwrite", is_flag=True, help="Replace OUTPUT if it exists.")
@click.option("--quiet", is_flag=True, help="No progress bar and no summary; warnings stay.")
@click.version_option(package_name="cndhf-codec")
def command(
    source: Path,
    target: Path | None,
    only_check: bool,
    as_json: bool,
    preset: Preset,
    representation: Representation,
    axes: int | None,
    width: int | None,
    target_size: str | None,
    target_error: str | None,
    unit: str | None,
    thicken: str | None,
    steps: int | None,
    time_limit: float | None,
    seed: int,
    threads: int | None,
    source_name: bool,
    overwrite: bool,
    quiet: bool,
) -> int:
    """Store the mesh INPUT (OBJ, PLY, STL, OFF, GLB, glTF or 3MF; .gz, .bz2, .xz or .zst of them) as OUTPUT.cndhf.

    INPUT or OUTPUT may be `-`, the standard input or output. Colours and texture coordinates are not kept; double
    height fields also fill hidden cavities.
    """
    given = standard_input() if source == STREAM else source
    if only_check:
        if target is not None:
            raise OptionError(f"--check writes nothing: leave {target} out")
        return _check(given, as_json, thicken, unit, seed, representation)
    if as_json:
        raise OptionError("--json goes with --check")
    if target is None:
        raise click.MissingParameter(param_hint="OUTPUT.cndhf", param_type="argument")
    from ..encoder.pipeline import encode
    from ..encoder.progress import Bar

    to_stream = target == STREAM
    if to_stream:
        check_standard_output()
    else:
        check_output(target, overwrite, [Path("/dev/stdin") if source == STREAM else source])
    bar = Bar(quiet)
    try:
        model = encode(
            given,
            preset=preset,
            representation=representation,
            axes=axes,
            width=width,
            target_size=target_size,
            target_error=target_error,
            unit=unit,
            thicken=thicken,
            steps=steps,
            time_limit=time_limit,
            seed=seed,
            threads=threads,
            source_name=source_name,
            progress=bar,
        )
    finally:
        bar.close()
    if to_stream:
        sys.stdout.buffer.write(model.dumps())
        sys.stdout.buffer.flush()
    else:
        model.save(target, overwrite=overwrite)
    if not (quiet or to_stream):
        click.echo(_summary(target, model, model.report))
    return 0


def _check(
    source: Path | BinaryIO, as_json: bool, thicken: str | None, unit: str | None, seed: int, wanted: Representation
) -> int:
    """Print the check and return the exit code, 1 where the mesh would be refused."""
    from ..encoder.check import check

    found = check(source, thicken=thicken, unit=unit, seed=seed)
    refused = wanted == "dhf" and found.refusal is not None
    click.echo(json.dumps(asdict(found), indent=2) if as_json else _checked(found, wanted))
    return 1 if refused else 0


def _checked(c: Check, wanted: Representation) -> str:
    from ..mesh.wording import counted, percent

    lines = [
        f"{c.name}: {c.faces} faces, {c.vertices} vertices, {counted(c.components, 'component')}",
        f"size {' x '.join(f'{e:.4g}' for e in c.extents)}, diagonal {c.diagonal:.4g}",
        f"boundary: {c.boundary_loops} loops of {c.boundary_edges} edges; non-manifold edges: {c.nonmanifold_edges}; "
        f"faces of zero area: {c.dropped_faces}",
    ]
    if c.flipped and c.refusal is None:
        lines.append(f"turned round: {percent(c.flipped)} of the surface")
    if c.self_intersections:
        lines.append(f"edges that pierce other faces: {percent(c.self_intersections)}")
    if c.parts is not None and c.minor_parts is not None and c.volume is not None:
        tiny = f" and {c.minor_parts} tiny ones" if c.minor_parts else ""
        if c.boundary_edges:  # faces may have cracks between them
            lines.append(f"volume: about {c.volume:.3g}; parts are not counted, for the surface is open")
        else:
            lines.append(f"parts that do not touch: {c.parts}{tiny}; volume: {c.volume:.7g}")
    if wanted != "surface" and c.hidden and c.filled is not None:
        lines.append(
            f"hidden from every axis, filled by double height fields: {percent(c.hidden)} of the surface, "
            f"a volume of about {c.filled:.4g}"
        )
    if wanted != "surface" and c.error_lower_bound:
        lines.append(
            f"what is filled costs a mean error of about {c.error_lower_bound:.3g} "
            f"({100 * c.error_lower_bound / c.diagonal:.3f} % of the diagonal) with {c.axes} axes; the fit's own error "
            "comes on top"
        )
    lines += [f"assumed: {line}" for line in c.assumptions]
    if wanted != "surface":
        lines += [f"assumed by double height fields: {line}" for line in c.dhf_assumptions]
    if c.refusal is None or wanted == "surface":
        lines.append("would be encoded")
    elif wanted == "dhf":
        lines.append(f"would be refused: {c.refusal}")
    else:
        lines.append(f"would be encoded as a surface; not as double height fields: {c.refusal}")
    return "\n".join(lines)


def _bodies(found: Bodies | None) -> str:
    from ..mesh.wording import counted

    assert found is not None
    if not found.closed:
        return f"open, volume about {found.volume:.3g}"
    tiny = f" and {found.minor} tiny" if found.minor else ""
    return f"{counted(found.parts)}{tiny}, volume {found.volume:.4g}"


def _summary(target: Path, model: Model, report: Report) -> str:
    d = report.distances
    assert d is not None

    def error(value: float) -> str:
        return f"{value:.4g} ({100 * value / report.diagonal:.3f} %)"

    mesh = model.container.surface
    if mesh is None:
        what = f"{len(model.container.dhfs)} double height fields"
    else:
        what = f"a surface of {len(mesh.positions)} control vertices"
    lines = [
        f"{target}: {len(model.dumps())} bytes, {what}, {sum(report.seconds.values()):.0f} s",
        "error in input units (and of the bounding box's diagonal): "
        f"mean {error(d.mean)}, p99 {error(d.p99)}, maximum {error(d.maximum)}",
        f"input: {_bodies(report.bodies)}; result: {_bodies(report.decoded)}",
    ]
    if report.other is not None:
        lines.append(_other(report.other, error))
    if mesh is None:
        lines.append(
            f"surface seen by the chosen axes: {100 * report.covered:.1f} % (by any axis: {100 * report.visible:.1f} %)"
        )
    return "\n".join(lines)


def _other(other: Other, error: Callable[[float], str]) -> str:
    name = {"dhf": "double height fields", "surface": "a surface"}[other.representation]
    if other.how == "impossible":
        return f"as {name}: not possible, for it bounds no solid"
    of = {"at least": "at least", "trial": "by a short trial about", "encoded": f"in {other.bytes} bytes"}[other.how]
    return f"as {name}: mean error {of} {error(other.mean_error)}"
