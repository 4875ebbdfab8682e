"""What no fit of the paper's kind can go below: the error of exact height fields, in our metric and in the paper's.

    python tools/paper_floor.py out.tsv rocker-arm fertility --fields 3

The axes are the paper's greedy choice. The solid of exact height fields along them is bounded by the part of the input
that they see, and by walls along the axes, where heights jump, as far as no other field cuts them away. CD is the mean
distance from points to the other surface, both ways, in the normalised frame. CD-paper is nearest point to nearest
point, 5 million of each surface, in the frame whose longest box side is 1: in that frame two samplings of one surface
give about what the paper prints for its largest networks (docs/paper.md); in ours they give more than it prints. Both
are times 1000.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from paper_table import SAMPLES, cd_paper
from scipy.spatial import cKDTree

from cndhf_codec.arrays import F64
from cndhf_codec.encoder.dhf.fit.samples import excluded_points
from cndhf_codec.encoder.dhf.fit.targets import HeightTargets, height_targets
from cndhf_codec.encoder.dhf.frames import Frame, frame_for_axis
from cndhf_codec.encoder.paper.axes import choose_axes
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.mesh.distances import point_distances
from cndhf_codec.mesh.normalise import normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid

RESOLUTION = 1536  # rays along the longer side of a domain box
JUMP = 3.0  # pixels: a smaller step of the heights is a slope of the surface
# A wall's area, counted in pixels' edges, is too large where it stands slantwise: 4 / pi on average.
STAIRCASE = np.pi / 4


def walls(t: HeightTargets, density: float, rng: np.random.Generator) -> F64:
    """(N, 3) points of the walls of a field, `density` per unit of area, in the normalised frame."""
    (u0, u1), (v0, v1), _ = t.frame.bounds
    size = np.array([(u1 - u0) / t.hit.shape[0], (v1 - v0) / t.hit.shape[1]])
    middle = (t.near + t.far) / 2
    # Beside the silhouette both heights are taken to meet half way: the wall goes from near to far.
    ends = [np.pad(np.where(t.hit, h, np.nan), 1, constant_values=np.nan) for h in (t.near, t.far)]
    half = np.pad(np.where(t.hit, middle, np.nan), 1, constant_values=np.nan)
    out = []
    for axis in range(2):
        first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        for h in ends:
            a, b = h[first], h[second]
            a, b = np.where(np.isnan(a), half[second], a), np.where(np.isnan(b), half[first], b)
            lo, hi = np.fmin(a, b), np.fmax(a, b)
            i, j = np.nonzero(hi - lo > JUMP * size.max())
            low, high = lo[i, j], hi[i, j]
            count = rng.poisson((high - low) * size[1 - axis] * density * STAIRCASE)
            k = np.repeat(np.arange(len(i)), count)
            along = np.stack([i[k], j[k]], axis=1) - 1.0 + 0.5  # the pixel's middle; the array has a border of 1
            along[:, axis] += 0.5
            along[:, 1 - axis] += rng.random(len(k)) - 0.5
            uv = np.array([u0, v0]) + along * size
            z = low[k] + rng.random(len(k)) * (high - low)[k]
            out.append(np.column_stack([uv, z]) @ t.frame.rotation)
    return np.concatenate(out)


def exact_surface(solid: Solid, frames: list[Frame], points: F64, normals: F64, area: float) -> tuple[F64, F64]:
    """Points of the surface of the exact height fields' solid, as dense as `points` are on the input: those that some
    axis sees, and those of the walls."""
    seen = np.zeros(len(points), dtype=bool)
    for f in frames:
        at = np.flatnonzero(~seen)
        seen[at] = solid.visible_along(f.rotation[2], points[at], normals[at])
    rng, kept = np.random.default_rng(4), []
    for k, f in enumerate(frames):
        t = height_targets(solid, f, RESOLUTION)
        wall = walls(t, len(points) / area, rng)
        others = [g for i, g in enumerate(frames) if i != k]
        if others and len(wall):
            wall = wall[~excluded_points(solid, others, wall).any(axis=1)]
        distance = point_distances(wall, solid.vertices, solid.faces)
        kept.append(wall[distance > 2 * (f.bounds[:2, 1] - f.bounds[:2, 0]).max() / RESOLUTION])
    return points[seen], np.concatenate(kept)


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--fields", default=3, show_default=True, help="Most fields.")
def main(target: Path, names: tuple[str, ...], fields: int) -> None:
    corpus = Path(os.environ.get("CNDHF_CORPUS", Path(__file__).parents[2] / "shared" / "corpus"))
    rows = ["mesh\tfields\tseen\tCD\tCD-paper\tsampling floor"]
    for name in names:
        mesh = read_mesh(corpus / f"{name}.ply")
        solid = Solid(normalisation(mesh).apply(mesh.vertices), mesh.faces)
        longest, area = float(np.ptp(solid.vertices, axis=0).max()), float(solid.areas.sum())
        truth, _ = solid.sample(SAMPLES, np.random.default_rng(1))
        points, normals = solid.sample(SAMPLES, np.random.default_rng(2))
        floor = cd_paper(truth, points, longest)
        axes = choose_axes(solid, replace(PAPER, max_axes=fields), 0, 2).axes
        for count in range(1, len(axes) + 1):
            frames = [frame_for_axis(a, solid.vertices) for a in axes[:count]]
            seen, wall = exact_surface(solid, frames, points, normals, area)
            surface = np.concatenate([seen, wall])
            # Points that are seen are on both surfaces; of the others, either way.
            hidden = cKDTree(surface).query(truth[: SAMPLES // 10])[0]
            spacing = np.sqrt(area / SAMPLES)
            there = np.where(hidden > 3 * spacing, hidden, 0).mean()
            back = point_distances(wall[::10], solid.vertices, solid.faces).sum() * 10 / len(surface)
            rows.append(
                f"{name}\t{count}\t{len(seen) / len(points):.4f}\t{1e3 * (there + back) / 2:.3f}\t"
                f"{1e3 * cd_paper(truth, surface, longest):.3f}\t{1e3 * floor:.3f}"
            )
            click.echo(rows[-1])
            target.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
