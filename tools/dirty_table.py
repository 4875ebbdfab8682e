"""What becomes of dirty meshes: `python tools/dirty_table.py results/0.2/dirty MESH ...` writes dirty.tsv, dirty.png.

Every mesh is encoded at preset `fast` and decoded by default; what is refused is encoded again with a wall. CD is the
mean error from the input as given, in its normalised frame, times 1000; the pictures show the input beside what comes
back.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np
from picture import plt, save

from cndhf_codec import encode
from cndhf_codec.errors import CndhfError
from cndhf_codec.mesh.distances import surface_distances
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid
from cndhf_codec.report.render import picture, view_frame

WALL = "1%"
COLUMNS = "mesh\toptions\toutcome\tbytes\tCD\tp99\tmaximum\tseconds\tassumptions"
VIEWS = ((35.0, 25.0), (215.0, -25.0))
PICTURE = 300  # pixels on a side

Row = tuple[str, list[np.ndarray]]  # a line of the table, and the pictures of what came back


def pictures(vertices: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    # What is not all inside the unit ball is a floater: keep it in the picture.
    scale = max(1.0, float(np.linalg.norm(vertices, axis=1).max()))
    solid = Solid(vertices / scale, faces.copy())
    return [picture(solid, view_frame(*view), PICTURE) for view in VIEWS]


def row(path: Path, thicken: str | None) -> Row:
    option = f"--thicken {thicken}" if thicken else ""
    start = time.perf_counter()
    try:
        model = encode(path, preset="fast", thicken=thicken)
        report = model.report
    except CndhfError as exc:
        line = str(exc).replace(str(path), path.name)
        return "\t".join(
            [path.name, option, f"refused: {line}", *[""] * 4, f"{time.perf_counter() - start:.0f}", ""]
        ), []
    seconds = time.perf_counter() - start
    mesh = read_mesh(path)
    norm = normalisation(mesh)
    surface = model.to_mesh()
    vertices, faces = norm.apply(np.asarray(surface.vertices)), np.asarray(surface.faces)
    d = surface_distances(norm.apply(mesh.vertices), mesh.faces, vertices, faces).scaled(1000)
    figures = [f"{len(model.dumps())}", f"{d.mean:.3f}", f"{d.p99:.2f}", f"{d.maximum:.1f}", f"{seconds:.0f}"]
    return "\t".join([path.name, option, "encoded", *figures, "; ".join(report.warnings)]), pictures(vertices, faces)


def draw(rows: list[tuple[str, list[np.ndarray], list[np.ndarray]]], target: Path) -> None:
    columns = 2 * len(VIEWS)
    figure, axes = plt.subplots(len(rows), columns, figsize=(columns * 2.6, len(rows) * 2.7), squeeze=False)
    for axis_row, (name, given, back) in zip(axes, rows, strict=True):
        for axis, shown in zip(axis_row, given + back, strict=False):
            axis.imshow(shown)
        for axis in axis_row:
            axis.axis("off")
        axis_row[0].set_title(name, fontsize=9, loc="left")
        axis_row[len(VIEWS)].set_title("comes back" if back else "refused", fontsize=9, loc="left")
    figure.tight_layout(pad=0.3)
    save(figure, target)
    plt.close(figure)


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("sources", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def main(target: Path, sources: tuple[Path, ...]) -> None:
    lines, rows = [COLUMNS], []
    for path in sources:
        mesh = read_mesh(path)
        given = pictures(normalisation(mesh).apply(mesh.vertices), mesh.faces)
        for thicken in (None, WALL):
            line, back = row(path, thicken)
            print(line, flush=True)
            lines.append(line)
            target.with_suffix(".tsv").write_text("\n".join(lines) + "\n")
            rows.append((f"{path.stem} {f'--thicken {thicken}' if thicken else ''}", given, back))
            if back:
                break
        draw(rows, target.with_suffix(".png"))


if __name__ == "__main__":
    main()
