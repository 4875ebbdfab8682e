"""How fair decoded meshes are: folds and self-intersections, beside those of the input.

    python tools/bench/fairness.py INPUT FILE [INPUT FILE ...]

folded: per cent of the area that looks the other way than the input at its nearest point. pierced: per cent of the
edges (at most 200,000 sampled ones) that pierce another face, of the input and of the decoded mesh.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from measure import normals_of

import cndhf_codec
from cndhf_codec.encoder.surface.nearest import Tree
from cndhf_codec.mesh.bodies import piercing
from cndhf_codec.mesh.prepare import as_given
from cndhf_codec.mesh.solid import Solid


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(path_type=Path))
def main(paths: tuple[Path, ...]) -> None:
    click.echo("file\tbytes\ttriangles\tfolded %\tpierced % of the input\tpierced %")
    for source, file in zip(paths[::2], paths[1::2], strict=True):
        given, model = as_given(source), cndhf_codec.load(file)
        mesh = model.to_mesh()
        out = Solid(given.norm.apply(np.asarray(mesh.vertices)), np.asarray(mesh.faces, dtype=np.int64))
        cells = (
            f"{folded(Tree(given.solid.vertices, given.solid.faces), Tree(out.vertices, out.faces)):.3f}",
            f"{100 * piercing(given.solid, 0)[1].mean():.3f}",
            f"{100 * piercing(out, 0)[1].mean():.3f}",
        )
        click.echo("\t".join([file.stem, str(file.stat().st_size), str(len(mesh.faces)), *cells]))


def folded(given: Tree, out: Tree) -> float:
    corners = out.vertices[out.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    closest = given.closest(corners.mean(axis=1))
    turned = np.sum(normals_of(out) * normals_of(given)[closest.faces], axis=1) < 0
    return 100 * float(area[turned].sum() / area.sum())


if __name__ == "__main__":
    main()
