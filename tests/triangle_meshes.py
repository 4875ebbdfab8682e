"""Closed meshes for queries, and the answers that brute force gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh

from cndhf_codec.arguments import chunks

Vectors = np.ndarray


class Mesh(NamedTuple):
    vertices: Vectors
    faces: Vectors


def joined(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + n for m, n in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def turned_inside_out(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def box(lo, hi) -> Mesh:
    made = trimesh.creation.box(bounds=[lo, hi])
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int64))


def sphere(radius: float = 0.8, detail: int = 2) -> Mesh:
    made = trimesh.creation.icosphere(detail, radius)
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int64))


def torus() -> Mesh:
    made = trimesh.creation.torus(0.6, 0.25, 24, 12)
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int64))


def rotated(mesh: Mesh) -> Mesh:
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    return Mesh(mesh.vertices @ turn.T, mesh.faces)


def with_flat_triangles(mesh: Mesh) -> Mesh:
    """Triangles without area, whose edges cancel: a face twice, once inside out, with its corners in one place."""
    n = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1], mesh.vertices[mesh.faces[5, :2]].mean(axis=0)[None]])
    a, b, c = mesh.faces[5]
    # The edge a b goes by way of its middle; the gap is closed by a triangle that is a line.
    faces = [*np.delete(mesh.faces, 5, axis=0), (a, n + 1, c), (n + 1, b, c), (a, b, n + 1), (0, n, 0), (n, n, n)]
    return Mesh(vertices, np.array(faces))


def splintered(mesh: Mesh) -> Mesh:
    """Every face cut in three at a point next to one of its edges, by 1e-4 to 1e-13 of its size."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    off = np.logspace(-4, -13, len(a))[:, None]
    cuts = (1 - off) * (0.6 * a + 0.4 * b) + off * c
    n = len(mesh.vertices) + np.arange(len(a))
    i, j, k = mesh.faces.T
    faces = np.concatenate([np.column_stack(f) for f in ((i, j, n), (j, k, n), (k, i, n))])
    return Mesh(np.concatenate([mesh.vertices, cuts]), faces)


def soup(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def needles() -> Mesh:
    """A cone of 100 long thin triangles over an ellipse, its tip far from the middle."""
    t = 2 * np.pi * np.arange(100) / 100
    rim = np.column_stack([0.9 * np.cos(t), 0.01 * np.sin(t), 0.3 * np.cos(t)])
    vertices = np.concatenate([rim, [[0.5, 0.2, 0.5], [-0.5, -0.2, -0.4]]])
    k = np.arange(100)
    after = (k + 1) % 100
    sides = [np.column_stack([k, after, 0 * k + 100]), np.column_stack([after, k, 0 * k + 101])]
    return Mesh(vertices, np.concatenate(sides))


MESHES: dict[str, Callable[[], Mesh]] = {
    "sphere": sphere,
    "box": lambda: box([-0.5, -0.25, -0.75], [0.5, 0.25, 0.75]),
    "turned box": lambda: rotated(box([-0.5, -0.25, -0.6], [0.5, 0.25, 0.6])),
    "torus": torus,
    "plate": lambda: box([-0.7, -0.7, 0], [0.7, 0.7, 1e-4]),
    "turned plate": lambda: rotated(box([-0.7, -0.7, 0], [0.7, 0.7, 1e-4])),
    "hollow sphere": lambda: joined(sphere(), turned_inside_out(sphere(0.5, 1))),
    "box with a cavity": lambda: joined(
        box([-0.5] * 3, [0.5] * 3), turned_inside_out(box([-0.25, -0.25, -0.5 + 1e-3], [0.25, 0.25, 0.25]))
    ),
    "sphere in a sphere": lambda: joined(sphere(), sphere(0.5, 1)),
    "overlapping boxes": lambda: joined(
        box([-0.5] * 3, [0.25] * 3), box([-0.25] * 3, [0.5] * 3), box([-0.5, -0.1, -0.1], [0.9, 0.1, 0.1])
    ),
    "inside out": lambda: joined(turned_inside_out(sphere(0.5, 1)), box([0.3] * 3, [0.55] * 3)),
    "flat triangles": lambda: with_flat_triangles(rotated(box([-0.5] * 3, [0.5] * 3))),
    "soup": lambda: soup(torus()),
    "needles": needles,
    "splinters": lambda: splintered(sphere(0.8, 1)),
    "turned splinters": lambda: splintered(rotated(box([-0.5] * 3, [0.5] * 3))),
    "one point": lambda: Mesh(np.full((3, 3), 0.25), np.array([[0, 1, 2], [2, 1, 0]])),
}


def winding_numbers(mesh: Mesh, points: Vectors) -> Vectors:
    """(N,) whole numbers: the sum of the solid angles of all triangles."""
    out = np.zeros(len(points))
    for first, last in chunks(len(points), 1 + 2**18 // len(mesh.faces)):
        d = mesh.vertices[mesh.faces][None] - points[first:last, None, None]
        length = np.linalg.norm(d, axis=-1)
        a, b, c = (d[:, :, k] for k in range(3))
        la, lb, lc = (length[:, :, k] for k in range(3))
        over = (a * np.cross(b, c)).sum(axis=-1)
        under = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        out[first:last] = np.arctan2(over, under).sum(axis=1) / (2 * np.pi)
    return np.rint(out).astype(int)


def distances(mesh: Mesh, points: Vectors) -> Vectors:
    """(N,) least distances from all triangles: from their edges, and along their normals where the foot is within."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    out = np.full(len(points), np.inf)
    for first, last in chunks(len(points), 1 + 2**18 // len(mesh.faces)):
        p = points[first:last, None]
        best = np.minimum.reduce([_from_segments(p, s, t) for s, t in ((a, b), (b, c), (c, a))])
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        sides = [(np.cross(t - s, p - s) * normal).sum(axis=-1) for s, t in ((a, b), (b, c), (c, a))]
        within = (np.minimum.reduce(sides) >= 0) & (length > 0)
        height = np.abs(((p - a) * normal).sum(axis=-1)) / np.where(length > 0, length, 1)
        out[first:last] = np.where(within, np.minimum(best, height), best).min(axis=1)
    return out


def _from_segments(p: Vectors, s: Vectors, t: Vectors) -> Vectors:
    along = t - s
    squared = (along**2).sum(axis=-1)
    k = np.clip(((p - s) * along).sum(axis=-1) / np.where(squared > 0, squared, 1), 0, 1)
    return np.linalg.norm(p - s - k[..., None] * along, axis=-1)


def points_around(mesh: Mesh, n: int = 2000) -> Vectors:
    """Points that are random, near the surface, and where ties may be: in line with corners, edges, faces."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    lo, hi = mesh.vertices.min(axis=0) - 0.1, mesh.vertices.max(axis=0) + 0.1
    on = (corners[rng.integers(len(corners), size=n)] * rng.dirichlet([1, 1, 1], n)[:, :, None]).sum(axis=1)
    near = [on + rng.normal(size=(n, 3)) * s for s in (1e-1, 1e-2, 1e-3, 1e-5)]
    special = np.concatenate([mesh.vertices, corners.mean(axis=1), (corners[:, 0] + corners[:, 1]) / 2])
    special = special[rng.integers(len(special), size=n)]
    in_line = []
    for axis in range(3):
        moved = special.copy()
        moved[:, axis] = rng.uniform(lo[axis], hi[axis], n)
        close = special.copy()
        close[:, axis] += rng.choice([-1e-2, 1e-2], n) * rng.uniform(0, 1, n)
        in_line += [moved, close]
    # In the planes of faces, beyond their edges.
    which = rng.integers(len(corners), size=n)
    a, e, f = corners[which, 0], corners[which, 1] - corners[which, 0], corners[which, 2] - corners[which, 0]
    coplanar = a + rng.uniform(-1, 2, (n, 1)) * e + rng.uniform(-1, 2, (n, 1)) * f
    along_edges = a + rng.uniform(-0.5, 1.5, (n, 1)) * e
    return np.concatenate([rng.uniform(lo, hi, (n, 3)), *near, special, *in_line, coplanar, along_edges])
