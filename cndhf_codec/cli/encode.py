"""`cndhf-encode`: encode a mesh file to a .cndhf file, or check what would become of the mesh."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from ..errors import CndhfError, OptionError
from ..files import STREAM, check_output
from .streams import check_standard_output, standard_input
from .summary import summary, united_line
from .terminal import say

if TYPE_CHECKING:
    from ..encoder.check import Check
    from ..encoder.settings import Preset, Representation


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("paths", metavar="INPUT... OUTPUT.cndhf", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--to",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Encode several INPUTs, each to DIR/NAME.cndhf; one that fails does not stop the others.",
)
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
    "Makes the smallest file found that keeps to it, by several encodes. Single points are ten to a hundred times as "
    "far off: see --target-max.",
)
@click.option(
    "--target-max",
    metavar="ERROR",
    help="Most maximum error, of 200,000 points on each surface, measured on the decoded file; as --target-error, and "
    "may go with it.",
)
@click.option(
    "--unit",
    type=click.Choice(["mm", "cm", "m", "in"]),
    help="What the input's unit is, for --target-error, --target-max and --thicken.",
)
@click.option(
    "--thicken",
    metavar="THICKNESS",
    help="Give open sheets, which have no inside, a wall: 1% of the bounding box's diagonal, a number in input units, "
    "or 2mm with --unit.",
)
@click.option(
    "--solid",
    is_flag=True,
    help="Unite overlapping parts first, and close holes, so that a surface has no faces inside. Double height fields "
    "do so in any case.",
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
    help="Make the fit short enough to keep to it, or fail; equal seeds then no longer give equal bytes. "
    "Compiling, on a machine's first encode, is not counted.",
)
@click.option("--seed", type=int, default=0, help="Equal seeds give equal bytes on one kind of machine.")
@click.option("--threads", type=int, help="Threads to use.  [default: all]")
@click.option("--source-name", is_flag=True, help="Write the input's file name into the output.")
@click.option("--overwrite", is_flag=True, help="Replace OUTPUT if it exists.")
@click.option("--force-name", is_flag=True, help="Write an OUTPUT whose name does not end in .cndhf.")
@click.option("-v", "--verbose", is_flag=True, help="Show the fit's loss, and more of the result.")
@click.option("--quiet", is_flag=True, help="No progress bar and no summary; warnings stay.")
@click.version_option(package_name="cndhf-codec")
def command(
    paths: tuple[Path, ...],
    folder: Path | None,
    only_check: bool,
    as_json: bool,
    preset: Preset,
    representation: Representation,
    axes: int | None,
    width: int | None,
    target_size: str | None,
    target_error: str | None,
    target_max: str | None,
    unit: str | None,
    thicken: str | None,
    solid: bool,
    steps: int | None,
    time_limit: float | None,
    seed: int,
    threads: int | None,
    source_name: bool,
    overwrite: bool,
    force_name: bool,
    verbose: bool,
    quiet: bool,
) -> int:
    """Store the mesh INPUT (OBJ, PLY, STL, OFF, GLB, glTF or 3MF; .gz, .bz2, .xz or .zst of them) as OUTPUT.cndhf.

    INPUT or OUTPUT may be `-`, the standard input or output. Colours and texture coordinates are not kept; double
    height fields also fill hidden cavities.
    """
    if not paths:
        raise click.MissingParameter(param_hint="INPUT", param_type="argument")
    if only_check:
        if len(paths) > 1 or folder is not None:
            raise OptionError(f"--check takes one INPUT and writes nothing: leave {folder or paths[1]} out")
        return _check(_given(paths[0]), as_json, thicken, unit, solid, seed, representation)
    if as_json:
        raise OptionError("--json goes with --check")
    jobs = _jobs(paths, folder, force_name)
    for source, target in jobs:
        if target == STREAM:
            check_standard_output()
        else:
            check_output(target, overwrite, [Path("/dev/stdin") if source == STREAM else source])
    from ..encoder.pipeline import encode
    from ..encoder.progress import Bar

    def run(source: Path, target: Path) -> None:
        bar = Bar(quiet, verbose)
        try:
            model = encode(
                _given(source),
                preset=preset,
                representation=representation,
                axes=axes,
                width=width,
                target_size=target_size,
                target_error=target_error,
                target_max=target_max,
                unit=unit,
                thicken=thicken,
                solid=solid,
                steps=steps,
                time_limit=time_limit,
                seed=seed,
                threads=threads,
                source_name=source_name,
                progress=bar,
            )
        finally:
            bar.close()
        if target == STREAM:
            sys.stdout.buffer.write(model.dumps())
            sys.stdout.buffer.flush()
        else:
            model.save(target, overwrite=overwrite)
        if not (quiet or target == STREAM):
            say(summary(source, target, model, verbose))

    if folder is None:
        run(*jobs[0])
        return 0
    failed = 0
    for source, target in jobs:
        try:
            run(source, target)
        except OptionError:
            raise
        except CndhfError as exc:
            failed = 1
            say(f"cndhf-encode: error: {' '.join(str(exc).split())}", err=True)
    return failed


def _jobs(paths: tuple[Path, ...], folder: Path | None, force_name: bool) -> list[tuple[Path, Path]]:
    """Inputs and outputs. Raises OptionError."""
    if folder is None:
        if len(paths) == 1:
            raise click.MissingParameter(param_hint="OUTPUT.cndhf (or --to DIR)", param_type="argument")
        if len(paths) > 2:
            raise OptionError(f"several INPUTs need --to DIR; otherwise leave {paths[2]} out")
        source, target = paths
        if target != STREAM and target.suffix.lower() != ".cndhf" and not force_name:
            raise OptionError(
                f"{target}: OUTPUT does not end in .cndhf; name it so, or pass --force-name (several INPUTs need --to)"
            )
        return [(source, target)]
    if not folder.is_dir():
        raise OptionError(f"{folder}: --to needs a folder that exists; make it first")
    jobs = [(source, folder / f"{_stem(source)}.cndhf") for source in paths]
    names: dict[Path, Path] = {}
    for source, target in jobs:
        if source == STREAM:
            raise OptionError("the standard input has no name to give a file in --to DIR; name an OUTPUT")
        if names.setdefault(target, source) != source:
            raise OptionError(f"{source}: would have the same output as {names[target]}, {target}; encode one apart")
    return jobs


def _stem(path: Path) -> str:
    """A mesh file's name without its extension, and that of a compressed one without both."""
    stem = Path(path.name).stem
    return Path(stem).stem if path.suffix.lower() in (".gz", ".bz2", ".xz", ".zst") else stem


def _given(source: Path) -> Path | BinaryIO:
    return standard_input() if source == STREAM else source


def _check(
    source: Path | BinaryIO,
    as_json: bool,
    thicken: str | None,
    unit: str | None,
    solid: bool,
    seed: int,
    wanted: Representation,
) -> int:
    """Print the check and return the exit code, 1 where the mesh would be refused."""
    from ..encoder.check import check

    found = check(source, thicken=thicken, unit=unit, solid=solid, seed=seed)
    refused = wanted == "dhf" and found.refusal is not None
    say(json.dumps(asdict(found), indent=2) if as_json else _checked(found, wanted))
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
    if c.united is not None:
        lines.append(united_line(c.united))
    if wanted != "surface" and c.hidden and c.filled is not None:
        lines.append(
            f"hidden from every axis, filled by double height fields: {percent(c.hidden)} of the surface, "
            f"a volume of about {c.filled:.4g}"
        )
    if wanted != "surface" and c.error_lower_bound:
        lines.append(
            f"what is filled alone costs a mean error of about {c.error_lower_bound:.3g} "
            f"({percent(c.error_lower_bound / c.diagonal)} of the diagonal) with {c.axes} axes, however large the file "
            "is; the fit's own error comes on top"
        )
    if c.lost:
        lines.append(f"not kept: {', '.join(c.lost)}")
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
