"""Make the two example meshes with manifold3d: `python examples/make_examples.py` writes them beside itself.

bracket.ply   a machined part: rounded plate, filleted boss, four bolt holes and a bore, all through.
creature.ply  a smooth organic body: blended balls.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, JoinType, Manifold

HERE = Path(__file__).parent


def bracket() -> Manifold:
    """80 x 50 x 26 mm."""
    segments = 64
    plate = CrossSection.square([60, 30], center=True).offset(10, JoinType.Round, circular_segments=segments)
    solid = Manifold.extrude(plate, 8)
    # Boss of radius 14 and height 18 on the plate, with a fillet of radius 4 at its foot: a profile turned about z.
    angle = np.linspace(np.pi, 1.5 * np.pi, 9)
    fillet = np.column_stack([18 + 4 * np.cos(angle), 12 + 4 * np.sin(angle)])
    profile = np.concatenate([[[0, 4], [18, 4]], fillet[::-1], [[14, 24], [12, 26], [0, 26]]])
    solid += CrossSection([profile]).revolve(segments)
    bore = Manifold.cylinder(40, 8, 8, segments).translate([0, 0, -5])
    bolt = Manifold.cylinder(40, 3.5, 3.5, 32).translate([0, 0, -5])
    for x in (-30, 30):
        for y in (-15, 15):
            bore += bolt.translate([x, y, 0])
    return solid - bore


def creature() -> Manifold:
    """A four-legged body about 2 units long, as the level set of a sum of Gaussians."""
    balls = [  # x, y, z, radius
        *((x, 0.05 * np.sin(3 * x), 0.1 * x * x, 0.34) for x in np.linspace(-0.6, 0.6, 7)),
        (0.85, 0, 0.28, 0.26),
        (1.05, 0, 0.25, 0.15),
        *((0.85, y, 0.52, 0.08) for y in (-0.14, 0.14)),
        *((x, y, z, 0.15) for x in (-0.5, 0.5) for y in (-0.2, 0.2) for z in (-0.25, -0.42, -0.58)),
        *((-0.8 - 0.05 * k, 0, 0.15 + 0.05 * k, 0.13 - 0.005 * k) for k in range(9)),
    ]
    centres = np.array([b[:3] for b in balls], dtype=float)
    radii = np.array([b[3] for b in balls], dtype=float)

    def field(x: float, y: float, z: float) -> float:
        squared = ((centres - [x, y, z]) ** 2).sum(axis=1)
        return float(np.log(np.exp(4 * (1 - squared / radii**2)).sum()) / 4)

    body = Manifold.level_set(field, [-1.6, -0.7, -1.0, 1.5, 0.7, 1.0], 0.06)
    return body.simplify(0.002)


def save(solid: Manifold, name: str) -> None:
    mesh = solid.to_mesh()
    out = trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=False)
    assert out.is_watertight, name
    out.export(HERE / name)
    print(f"{name}: {len(out.faces)} triangles, volume {out.volume:.4g}")


if __name__ == "__main__":
    save(bracket(), "bracket.ply")
    save(creature(), "creature.ply")
