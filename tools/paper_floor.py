"""What no fit of the paper's kind can go below: the error of exact height fields, in our metric and in the paper's.

    python tools/paper_floor.py out.tsv rocker-arm fertility --fields 3
    python tools/paper_floor.py out.tsv rocker-arm fertility --fields 3 --mirrored

The axes are the paper's greedy choice among its candidates, or among their mirror images. The solid of exact height
fields along them is bounded by the part of the input that they see, and by walls along the axes, where heights jump, as
far as no other field cuts them away. CD is the mean distance from points to the other surface, both ways, in the
normalised frame. CD-paper is nearest point to nearest point of two samplings of 5 million points, in the frame whose
longest box side is 1: in that frame two samplings of one surface give about what the paper prints for its largest
networks (docs/paper.md); in ours they give more than it prints. Both are times 1000.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import click
import numpy as np
from scipy.spatial import cKDTree

from cndhf_codec.arrays import F64
from cndhf_codec.encoder.dhf.fit.samples import excluded_points
from cndhf_codec.encoder.dhf.fit.targets import HeightTargets, height_targets
from cndhf_codec.encoder.dhf.frames import Frame, frame_for_axis
from cndhf_codec.encoder.paper import axes
from cndhf_codec.encoder.paper.settings import PAPER
from cndhf_codec.mesh.distances import point_distances
from cndhf_codec.mesh.normalise import Normalisation, normalisation
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.sampling import sample_surface
from cndhf_codec.mesh.solid import Solid

SAMPLES = 5_000_000
EACH = 10  # distances are measured from every tenth sample, whose mean is right to 0.1 %
RESOLUTION = 1536  # rays along the longer side of a domain box
JUMP = 3.0  # pixels: a smaller step of the heights is a slope of the surface
# A wall's area, counted in pixels' edges, is too large where it stands slantwise: 4 / pi on average.
STAIRCASE = np.pi / 4


def corpus() -> Path:
    return Path(os.environ.get("CNDHF_CORPUS", Path(__file__).parents[2] / "shared" / "corpus"))


@dataclass(frozen=True, eq=False)
class Reference:
    """An input in the normalised frame. points, others: (N, 3), two samplings of it. normals: those of `others`."""

    norm: Normalisation
    solid: Solid
    points: F64
    others: F64
    normals: F64

    @classmethod
    def read(cls, name: str) -> Reference:
        mesh = read_mesh(corpus() / f"{name}.ply")
        norm = normalisation(mesh)
        solid = Solid(norm.apply(mesh.vertices), mesh.faces)
        points = sample_surface(solid.vertices, solid.faces, SAMPLES, seed=1)
        return cls(norm, solid, points, *solid.sample(SAMPLES, np.random.default_rng(2)))

    @cached_property
    def longest(self) -> float:
        return float(np.ptp(self.solid.vertices, axis=0).max())

    @cached_property
    def area(self) -> float:
        return float(self.solid.areas.sum())

    @cached_property
    def tree(self) -> cKDTree:
        return tree_of(self.points)

    @cached_property
    def sampling_floor(self) -> float:
        """What two samplings of one surface give: no reconstruction can do better."""
        return self.cd_paper(self.others)

    def cd_paper(self, points: F64) -> float:
        """Of as many points of another surface, in the normalised frame."""
        forth = tree_of(points).query(self.points[::EACH])[0].mean()
        back = self.tree.query(points[::EACH])[0].mean()
        return float(forth + back) / 2 / self.longest


@dataclass(frozen=True)
class Floor:
    """seen: share of the surface that some field sees. cd: in the normalised frame."""

    seen: float
    cd: float
    cd_paper: float


def tree_of(points: F64) -> cKDTree:
    return cKDTree(points, balanced_tree=False, compact_nodes=False)  # both cost more than they save here


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


def exact_floor(shape: Reference, frames: list[Frame]) -> Floor:
    """The errors of the solid that exact height fields bound. Its surface is what some axis sees, and walls."""
    solid, points = shape.solid, shape.others
    seen = np.zeros(len(points), dtype=bool)
    for f in frames:
        at = np.flatnonzero(~seen)
        seen[at] = solid.visible_along(f.rotation[2], points[at], shape.normals[at])
    rng, kept, back = np.random.default_rng(4), [points[seen]], 0.0
    for k, f in enumerate(frames):
        t = height_targets(solid, f, RESOLUTION)
        wall = walls(t, len(points) / shape.area, rng)
        others = [g for i, g in enumerate(frames) if i != k]
        if others and len(wall):
            wall = wall[~excluded_points(solid, others, wall).any(axis=1)]
        distance = point_distances(wall, solid.vertices, solid.faces)
        off = distance > 2 * (f.bounds[:2, 1] - f.bounds[:2, 0]).max() / RESOLUTION
        kept.append(wall[off])
        back += float(distance[off].sum())
    surface = np.concatenate(kept)
    # Points that are seen are on both surfaces; of the others, either way.
    there = tree_of(surface).query(shape.points[::EACH])[0]
    hidden = np.where(there > 3 * np.sqrt(shape.area / len(points)), there, 0).mean()
    return Floor(float(seen.mean()), float(hidden + back / len(surface)) / 2, shape.cd_paper(surface))


@click.command()
@click.argument("target", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
@click.option("--fields", default=3, show_default=True, help="Most fields.")
@click.option("--mirrored", is_flag=True, help="Mirror the candidates in the plane of x and z.")
def main(target: Path, names: tuple[str, ...], fields: int, mirrored: bool) -> None:
    if mirrored:
        given = axes.candidates()
        axes.candidates = lambda: given * [1, -1, 1]
    rows = ["mesh\tcandidates\tfields\tseen\tCD\tCD-paper\tsampling floor"]
    for name in names:
        shape = Reference.read(name)
        chosen = axes.choose_axes(shape.solid, replace(PAPER, max_axes=fields), 0, 1).axes
        frames = [frame_for_axis(a, shape.solid.vertices) for a in chosen]
        for count in range(1, len(frames) + 1):
            floor = exact_floor(shape, frames[:count])
            rows.append(
                f"{name}\t{'mirrored' if mirrored else 'as used'}\t{count}\t{floor.seen:.4f}\t{1e3 * floor.cd:.3f}\t"
                f"{1e3 * floor.cd_paper:.3f}\t{1e3 * shape.sampling_floor:.3f}"
            )
            click.echo(rows[-1])
            target.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
