"""Dirty surfaces: boxes, sheets, parts that touch."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid

CUBE = ([-0.5] * 3, [0.5] * 3)


def solid_of(*meshes: trimesh.Trimesh) -> Solid:
    mesh = read_mesh(trimesh.util.concatenate(list(meshes)))
    return Solid(mesh.vertices, mesh.faces)


def box(lo, hi, inverted=False) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(bounds=[lo, hi])
    if inverted:
        mesh.invert()
    return mesh


def sheet(n=8) -> trimesh.Trimesh:
    """A square of side 1 in the plane z = 0."""
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-0.5, 0.5, n + 1)] * 2, indexing="ij"))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + n + 1, i + 1], 1), np.stack([i + 1, i + n + 1, i + n + 2], 1)])
    return trimesh.Trimesh(np.stack([x, y, 0 * x], 1), faces, process=False)


def touching() -> trimesh.Trimesh:
    """The cube as two halves, with a wall of two pairs of faces between them."""
    half = box([-0.5] * 3, [0, 0.5, 0.5])
    other = trimesh.Trimesh(half.vertices * [-1, 1, 1], half.faces[:, ::-1], process=False)
    return trimesh.util.concatenate([half, other])


def is_closed_and_outward(solid: Solid, volume: float) -> bool:
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    return mesh.is_watertight and mesh.is_winding_consistent and mesh.volume == pytest.approx(volume)
