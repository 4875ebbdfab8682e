"""Collision queries against a .cndhf file, with numpy only and without a mesh.

    python examples/robot_collision.py obstacle.cndhf

A robot's link is covered with sample points, here of a capsule that moves towards the obstacle. `contains` says which
are inside, `ray_intersect` how far the link may go before it touches; in contact, f / |grad f| estimates the signed
distance, and -grad f / |grad f| is the way out.
"""

from __future__ import annotations

import sys

import numpy as np

import cndhf_codec


def capsule_points(start: np.ndarray, end: np.ndarray, radius: float, n: int = 2000) -> np.ndarray:
    """(n, 3) points on a capsule's surface, by the golden angle along its axis."""
    t = (np.arange(n) + 0.5) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    length = np.linalg.norm(end - start)
    along = t * (length + 2 * radius) - radius  # the caps reach beyond the ends
    beyond = along - np.clip(along, 0, length)
    across = np.sqrt(np.maximum(radius**2 - beyond**2, 0))[:, None]
    return (
        start
        + along[:, None] * axis
        + across * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
    )


def signed_distance(model: cndhf_codec.Model, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimates of the distance to the surface, negative inside, and the outward directions.

    Right to first order: good near the surface, where collisions are. Further away take it as a sign only: it can be
    a small part of the distance there.
    """
    f, gradient = model.implicit(points, gradient=True)
    slope = np.maximum(np.linalg.norm(gradient, axis=-1), 1e-9)
    return -f / slope, -gradient / slope[..., None]


def main() -> None:
    if len(sys.argv) != 2:
        raise SystemExit("usage: python examples/robot_collision.py obstacle.cndhf")
    model = cndhf_codec.load(sys.argv[1])
    centre, scale = np.array(model.info["centre"]), model.info["scale"]
    way = np.array([-1.0, 0, 0])
    for offset in np.linspace(1.5, 0.0, 7):
        start = centre + scale * np.array([offset, -0.3, 0])
        link = capsule_points(start, start + scale * np.array([0, 0.6, 0]), 0.1 * scale)
        inside = model.contains(link)
        if inside.any():
            distance, outward = signed_distance(model, link[inside])
            deepest = distance.argmin()
            verdict = (
                f"{inside.sum()} of {len(link)} points inside, the deepest by about {-distance[deepest]:.3f}, "
                f"way out {np.round(outward[deepest], 2)}"
            )
        else:
            verdict = f"free, for another {model.ray_intersect(link, way).distance.min():.3f}"
        print(f"at {offset * scale:8.3f}: {verdict}")


if __name__ == "__main__":
    main()
