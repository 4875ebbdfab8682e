"""`cndhf-decode`: decode a .cndhf file to a mesh file or an occupancy grid."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from ..errors import OptionError
from ..files import STREAM, check_output
from .streams import check_standard_output, read_input
from .terminal import say

if TYPE_CHECKING:
    from ..decoder.model import Model
    from ..decoder.representation import Detail


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("source", metavar="INPUT.cndhf", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUTPUT]", required=False, type=click.Path(path_type=Path))
@click.option("--faces", type=int, help="At most so many triangles.  [default: as many as the file's error needs]")
@click.option(
    "--max-error",
    metavar="ERROR",
    help="In place of --faces: about the greatest distance from the exact surface, a number in input units or 0.1% of "
    "the bounding box's diagonal.",
)
@click.option("--level", type=int, help="Of surfaces: subdivide so often, 0 to 6, in place of an error.")
@click.option(
    "--resolution",
    type=int,
    help="Of double height fields: marching cubes with so many cells along the longest side, not simplified. Also of "
    "--occupancy.  [default: 128 to 256, by the file's error; of --occupancy 256]",
)
@click.option(
    "--method",
    type=click.Choice(["marching-cubes", "intersection"]),
    help="Of double height fields: how the surface is made; `intersection` keeps creases exact and takes longer.  "
    "[default: marching-cubes; intersection where walls are thinner than a cell]",
)
@click.option("--specks", is_flag=True, help="Of double height fields: keep pieces smaller than the file's error.")
@click.option(
    "--normals/--no-normals",
    default=None,
    help="Write vertex normals (.ply, .obj, .glb), those of the exact surface.  [default: in .glb only]",
)
@click.option(
    "--format", "format_", type=click.Choice(["ply", "obj", "stl", "off", "glb"]), help="What to write to OUTPUT -."
)
@click.option(
    "--embed",
    is_flag=True,
    help="Of .glb: carry INPUT.cndhf, too, for readers of the glTF extension CNDHF_shape; others draw the mesh.",
)
@click.option(
    "--embed-only",
    is_flag=True,
    help="Of .glb: carry INPUT.cndhf in place of a mesh, with 1 kB around it; other readers refuse it.",
)
@click.option(
    "--lod",
    metavar="N",
    type=int,
    help="Write N levels of detail: OUTPUT.lod0.EXT, the mesh that the other options say, OUTPUT.lod1.EXT with a "
    "quarter of its triangles, and so on.",
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
    faces: int | None,
    max_error: str | None,
    level: int | None,
    resolution: int | None,
    method: Literal["marching-cubes", "intersection"] | None,
    specks: bool,
    normals: bool | None,
    format_: str | None,
    embed: bool,
    embed_only: bool,
    lod: int | None,
    occupancy: Path | None,
    overwrite: bool,
    quiet: bool,
) -> None:
    """Turn INPUT.cndhf into the mesh OUTPUT; its extension says how: .ply, .obj, .stl, .off or .glb.

    INPUT or OUTPUT may be `-`, the standard input or output; --format says how then. By default there are as many
    triangles as the file's own error needs: fewer would add more than a few percent to it, more would gain nothing.
    """
    from ..decoder.dhf.meshes import DEFAULT_RESOLUTION
    from ..decoder.glb import Embedded
    from ..decoder.gridfile import write_grid
    from ..decoder.meshfile import check_embedded, check_extension, check_normals, mesh_bytes, write_mesh
    from ..decoder.reading import load_bytes
    from ..decoder.representation import Detail

    if target is None and occupancy is None:
        raise OptionError("nothing to write: name an OUTPUT mesh, or --occupancy GRID.npz")
    to_stream = target == STREAM
    if to_stream != (format_ is not None):
        raise OptionError("--format belongs to the OUTPUT -: a file's extension says its format")
    if lod is not None and (target is None or to_stream):
        raise OptionError("--lod needs an OUTPUT file, to name its levels after")
    if lod is not None and lod < 1:
        raise OptionError(f"--lod is {lod}: 1 or more are needed")
    cells = DEFAULT_RESOLUTION if resolution is None else resolution
    embed = embed or embed_only
    if embed and (target is None or lod is not None):
        raise OptionError("--embed needs one OUTPUT: readers would make the same mesh of every level of --lod")
    detail = Detail(resolution, method, max_error, faces, level, specks)
    if embed_only:
        of_a_mesh = detail if occupancy is None else detail._replace(resolution=None)
        if normals is not None or of_a_mesh != Detail():
            raise OptionError("--embed-only writes no mesh: leave out what belongs to one, or use --embed")
        normals = False
    if normals is None:
        normals = target is not None and (format_ or target.suffix[1:]).lower() == "glb"
    paths = [] if target is None else [target] if lod is None else _paths(target, lod)
    for path in paths:
        named = Path(f"-.{format_}") if to_stream else path
        if normals:
            check_normals(named)
        if embed:
            check_embedded(named)
        if not to_stream:
            check_extension(path)
            check_output(path, overwrite, [source])
    if occupancy is not None:
        if occupancy == STREAM:
            raise OptionError("--occupancy needs a file: the grid does not go to the standard output")
        check_output(occupancy, overwrite, [source])
        if occupancy.absolute() in [path.absolute() for path in paths]:
            raise OptionError(f"{occupancy}: the mesh and the grid cannot be one file; name two")
    if to_stream:
        check_standard_output()
    data, name = read_input(source)
    model = load_bytes(data, name)
    if embed_only or (model.representation == "surface" and occupancy is not None):
        detail = detail._replace(resolution=None)  # it is that of the grid
    embedded = Embedded(data, not embed_only) if embed else None
    # Make all before writing any: an interrupt leaves nothing.
    meshes = [] if not paths else _meshes(model, detail, normals, lod)
    grid = None if occupancy is None else model.occupancy(cells)
    for path, mesh in zip(paths, meshes, strict=True):
        if format_ is not None:
            out, note = mesh_bytes(mesh, format_, normals, embedded)
            sys.stdout.buffer.write(out)
            sys.stdout.buffer.flush()
        else:
            note = write_mesh(mesh, path, overwrite, normals, embedded)
        if note is not None:
            say(f"cndhf-decode: warning: {note}", err=True)
        if not (quiet or to_stream):
            closed = bool(model.info.get("closed", True))
            what = f"{path.stat().st_size} bytes, no mesh" if embed_only else _summary(mesh, closed, normals)
            say(f"{path}: {what}")
    if grid is not None and occupancy is not None:
        write_grid(occupancy, *grid, overwrite)
        if not quiet:
            shape = " x ".join(str(n) for n in grid[0].shape)
            # Where the standard output holds a mesh, the summary goes to standard error.
            say(f"{occupancy}: {shape} nodes, {100 * grid[0].mean():.1f} % inside", err=to_stream)


def _paths(target: Path, n: int) -> list[Path]:
    """Where n levels of detail go."""
    return [target.with_name(f"{target.stem}.lod{k}{target.suffix}") for k in range(n)]


def _summary(mesh: Any, closed: bool, normals: bool) -> str:
    """closed: whether the shape is. Normals make seams in the mesh of a surface; the surface itself has none there."""
    from ..decoder.pieces import piece_labels

    seams = normals and closed and not mesh.is_watertight
    whole = closed and (mesh.is_watertight or seams)
    out = f"{len(mesh.faces)} triangles, watertight: {'yes' if whole else 'no'}"
    if seams:
        return out
    pieces = int(piece_labels(np.asarray(mesh.faces), len(mesh.vertices)).max()) + 1
    return f"{out}, {pieces} piece{'s' * (pieces != 1)}"


def _meshes(model: Model, detail: Detail, normals: bool, n: int | None) -> list[Any]:
    """The mesh, or n levels of detail. Each has a quarter of the triangles of the one before."""
    from ..decoder.simplify import LEAST_FACES

    finest = model.to_mesh(normals=normals, **detail._asdict())
    if n is None:
        return [finest]
    rest = detail._replace(max_error=None, level=None)
    counts = [len(finest.faces) // 4**k for k in range(1, n)]
    if n > 1 and counts[-1] < LEAST_FACES:
        raise OptionError(f"--lod is {n}: the last level would have {counts[-1]} triangles; ask for fewer levels")
    return [finest, *(model.to_mesh(normals=normals, **rest._replace(faces=c)._asdict()) for c in counts)]
