"""`cndhf-decode`: .cndhf file -> mesh file or occupancy grid."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import OptionError
from ..files import check_output


@click.command(context_settings={"show_default": True})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUTPUT]", required=False, type=click.Path(path_type=Path))
@click.option("--resolution", type=int, default=256, help="Grid cells along the longest side of the solid.")
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
    source: Path, target: Path | None, resolution: int, occupancy: Path | None, overwrite: bool, quiet: bool
) -> None:
    """Turn INPUT.cndhf into the mesh OUTPUT; its extension says how: .ply, .obj, .stl, .off or .glb."""
    from ..decoder.gridfile import write_grid
    from ..decoder.meshfile import check_extension, write_mesh
    from ..decoder.model import load

    if target is None and occupancy is None:
        raise OptionError("nothing to write: name an OUTPUT mesh, or --occupancy GRID.npz")
    if target is not None:
        check_extension(target)
        check_output(target, overwrite)
    if occupancy is not None:
        check_output(occupancy, overwrite)
    if target is not None and occupancy is not None and target.absolute() == occupancy.absolute():
        raise OptionError(f"{target}: the mesh and the grid cannot be one file; name two")
    model = load(source)
    # Both are made before either is written: an interrupt leaves nothing.
    mesh = None if target is None else model.to_mesh(resolution)
    grid = None if occupancy is None else model.occupancy(resolution)
    if mesh is not None and target is not None:
        warning = write_mesh(mesh, target, overwrite)
        if warning is not None:
            click.echo(f"cndhf-decode: warning: {warning}", err=True)
        if not quiet:
            click.echo(f"{target}: {len(mesh.faces)} triangles, watertight: {'yes' if mesh.is_watertight else 'no'}")
    if grid is not None and occupancy is not None:
        write_grid(occupancy, *grid, overwrite)
        if not quiet:
            shape = " x ".join(str(n) for n in grid[0].shape)
            click.echo(f"{occupancy}: {shape} nodes, {100 * grid[0].mean():.1f} % inside")
