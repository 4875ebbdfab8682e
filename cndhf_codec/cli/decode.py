"""`cndhf-decode`: decode a .cndhf file to a mesh file or an occupancy grid."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

import click

from ..errors import OptionError
from ..files import STREAM, check_output
from .streams import check_standard_output, standard_input

COARSEST = 8  # the least resolution


@click.command(context_settings={"show_default": True})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUTPUT]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--resolution", type=int, help="Grid cells along the longest side of the solid.  [default: 256, see --method]"
)
@click.option(
    "--method",
    type=click.Choice(["marching-cubes", "intersection"]),
    help="How the surface is made; `intersection` keeps creases sharp and makes far fewer triangles.  "
    "[default: marching-cubes; intersection where walls are thinner than a cell and no --resolution is given]",
)
@click.option(
    "--max-error",
    metavar="ERROR",
    help="For --method intersection: distance from the exact surface, a number in input units or 0.1% of the "
    "bounding box's diagonal (default: 0.02%).",
)
@click.option("--faces", type=int, help="For --method intersection: at most so many triangles, in place of an error.")
@click.option("--normals", is_flag=True, help="Write vertex normals (.ply, .obj, .glb), from the analytic gradient.")
@click.option(
    "--format", "format_", type=click.Choice(["ply", "obj", "stl", "off", "glb"]), help="What to write to OUTPUT -."
)
@click.option(
    "--lod",
    metavar="N",
    type=int,
    help="Write N levels of detail: OUTPUT.lod0.EXT at --resolution, OUTPUT.lod1.EXT at half of it, and so on.",
)
@click.option(
    "--occupancy",
    metavar="GRID.npz",
    type=click.Path(path_type=Path),
    help="Write the in/out grid too: boolean array `occupancy`, `origin` (3,) and `spacing` in input units.",
)
@click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
@click.option("--quiet", is_flag=True, help="No summary.")
@click.version_option(package_name="cndhf-codec")
def command(
    source: Path,
    target: Path | None,
    resolution: int | None,
    method: Literal["marching-cubes", "intersection"] | None,
    max_error: str | None,
    faces: int | None,
    normals: bool,
    format_: str | None,
    lod: int | None,
    occupancy: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Turn INPUT.cndhf into the mesh OUTPUT; its extension says how: .ply, .obj, .stl, .off or .glb.

    INPUT or OUTPUT may be `-`, the standard input or output; --format says how then.
    """
    from ..decoder.gridfile import write_grid
    from ..decoder.meshfile import check_extension, check_normals, mesh_bytes, write_mesh
    from ..decoder.model import DEFAULT_RESOLUTION, load, load_stream

    if target is None and occupancy is None:
        raise OptionError("nothing to write: name an OUTPUT mesh, or --occupancy GRID.npz")
    to_stream = target == STREAM
    if to_stream != (format_ is not None):
        raise OptionError("--format belongs to the OUTPUT -: a file's extension says its format")
    if lod is not None and (target is None or to_stream or method == "intersection"):
        raise OptionError("--lod needs an OUTPUT file, to name its levels after, and marching cubes")
    cells = DEFAULT_RESOLUTION if resolution is None else resolution
    levels = {} if target is None else {target: resolution} if lod is None else _levels(target, cells, lod)
    for path in levels:
        if normals:
            check_normals(Path(f"-.{format_}") if to_stream else path)
        if not to_stream:
            check_extension(path)
            check_output(path, overwrite, [source])
    if occupancy is not None:
        if occupancy == STREAM:
            raise OptionError("--occupancy needs a file: the grid does not go to the standard output")
        check_output(occupancy, overwrite, [source])
        if occupancy.absolute() in [path.absolute() for path in levels]:
            raise OptionError(f"{occupancy}: the mesh and the grid cannot be one file; name two")
    if to_stream:
        check_standard_output()
    model = load_stream(standard_input(), "standard input") if source == STREAM else load(source)
    # Make all before writing any: an interrupt leaves nothing.
    meshes = {path: model.to_mesh(n, method, max_error, faces, normals) for path, n in levels.items()}
    grid = None if occupancy is None else model.occupancy(cells)
    for path, mesh in meshes.items():
        if format_ is not None:
            data, note = mesh_bytes(mesh, format_, normals)
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        else:
            note = write_mesh(mesh, path, overwrite, normals)
        if note is not None:
            click.echo(f"cndhf-decode: warning: {note}", err=True)
        if not (quiet or to_stream):
            click.echo(f"{path}: {len(mesh.faces)} triangles, watertight: {'yes' if mesh.is_watertight else 'no'}")
    if grid is not None and occupancy is not None:
        write_grid(occupancy, *grid, overwrite)
        if not quiet:
            shape = " x ".join(str(n) for n in grid[0].shape)
            # Where the standard output holds a mesh, the summary goes to standard error.
            click.echo(f"{occupancy}: {shape} nodes, {100 * grid[0].mean():.1f} % inside", err=to_stream)


def _levels(target: Path, resolution: int, n: int) -> dict[Path, int | None]:
    """Paths and resolutions of levels of detail. Each has about a quarter of the triangles of the one before."""
    if n < 1 or resolution >> (n - 1) < COARSEST:
        raise OptionError(
            f"--lod is {n}: 1 or more, and the last level's resolution, {resolution} halved {max(n - 1, 0)} times, "
            f"must be {COARSEST} or more"
        )
    return {target.with_name(f"{target.stem}.lod{k}{target.suffix}"): resolution >> k for k in range(n)}
