"""`cndhf-decode`: .cndhf file -> mesh file or occupancy grid."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Literal

import click

from ..errors import OptionError
from ..files import check_output


@click.command(context_settings={"show_default": True})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUTPUT]", required=False, type=click.Path(path_type=Path))
@click.option("--resolution", type=int, default=256, help="Grid cells along the longest side of the solid.")
@click.option(
    "--method",
    type=click.Choice(["marching-cubes", "intersection"]),
    default="marching-cubes",
    help="How the surface is made; `intersection` keeps creases sharp and makes far fewer triangles.",
)
@click.option(
    "--max-error",
    metavar="ERROR",
    help="For --method intersection: distance from the exact surface, a number in input units or 0.1% of the "
    "bounding box's diagonal (default: 0.03%).",
)
@click.option("--faces", type=int, help="For --method intersection: at most so many triangles, in place of an error.")
@click.option("--normals", is_flag=True, help="Write vertex normals (.ply, .obj, .glb), from the analytic gradient.")
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
    resolution: int,
    method: Literal["marching-cubes", "intersection"],
    max_error: str | None,
    faces: int | None,
    normals: bool,
    occupancy: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Turn INPUT.cndhf into the mesh OUTPUT; its extension says how: .ply, .obj, .stl, .off or .glb."""
    from ..decoder.gridfile import write_grid
    from ..decoder.meshfile import check_extension, check_normals, write_mesh
    from ..decoder.model import load

    if target is None and occupancy is None:
        raise OptionError("nothing to write: name an OUTPUT mesh, or --occupancy GRID.npz")
    if target is not None:
        check_extension(target)
        if normals:
            check_normals(target)
        check_output(target, overwrite)
    if occupancy is not None:
        check_output(occupancy, overwrite)
    if target is not None and occupancy is not None and target.absolute() == occupancy.absolute():
        raise OptionError(f"{target}: the mesh and the grid cannot be one file; name two")
    model = load(source)
    # Both are made before either is written: an interrupt leaves nothing.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = None if target is None else model.to_mesh(resolution, method, max_error, faces, normals)
    for warning in caught:
        click.echo(f"cndhf-decode: warning: {source}: {warning.message}", err=True)
    grid = None if occupancy is None else model.occupancy(resolution)
    if mesh is not None and target is not None:
        note = write_mesh(mesh, target, overwrite, normals)
        if note is not None:
            click.echo(f"cndhf-decode: warning: {note}", err=True)
        if not quiet:
            click.echo(f"{target}: {len(mesh.faces)} triangles, watertight: {'yes' if mesh.is_watertight else 'no'}")
    if grid is not None and occupancy is not None:
        write_grid(occupancy, *grid, overwrite)
        if not quiet:
            shape = " x ".join(str(n) for n in grid[0].shape)
            click.echo(f"{occupancy}: {shape} nodes, {100 * grid[0].mean():.1f} % inside")
