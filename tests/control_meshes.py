"""Control meshes and targets for the tests of the surface encoder."""

from __future__ import annotations

import numpy as np
import trimesh

from cndhf_codec.encoder.surface.basis import basis_of
from cndhf_codec.encoder.surface.creases import Fitted
from cndhf_codec.encoder.surface.cut import Manifold
from cndhf_codec.encoder.surface.fit import fit, mean_errors
from cndhf_codec.encoder.surface.target import Target
from cndhf_codec.mesh.distances import surface_distances

NO_EDGES = np.zeros((0, 2), dtype=np.int64)


def arrays(mesh: trimesh.Trimesh) -> Manifold:
    return Manifold(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def target_of(mesh: trimesh.Trimesh, samples: int = 20_000) -> Target:
    return Target(*arrays(mesh), samples, 0)


def smooth_fit(mesh: Manifold, target: Target, levels: int, rounds: int) -> Fitted:
    """A fit without sharp edges but those of the boundary."""
    basis = basis_of(mesh.faces, len(mesh.vertices), NO_EDGES, levels)
    control = fit(basis, target, mesh.vertices, rounds)
    return Fitted(basis, NO_EDGES, control, float(mean_errors(basis, target, control).sum()))


def mean_distance(target: Target, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Between a target and a mesh, measured with samples of their own."""
    return surface_distances(target.vertices, target.faces, vertices, faces, samples=20_000).mean


def square(n: int) -> trimesh.Trimesh:
    """A square of side 1 in the plane z = 0, of 2 n^2 faces."""
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2, indexing="ij"))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + n + 1, i + 1], 1), np.stack([i + 1, i + n + 1, i + n + 2], 1)])
    return trimesh.Trimesh(np.stack([x, y, 0 * x], 1), faces, process=False)
