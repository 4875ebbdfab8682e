"""Choose the edges that are sharp, by what they do to the error.

Three fits are made: with no sharp edge, with those of a large angle between their faces, with all (a polyhedron). Each
edge is then as it is in the fit that leaves least error around it. Where that mixture pays for its marks, it is taken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64, Mask
from ...decoder.surface.subdivision import topology_of
from .basis import Basis, basis_of
from .cut import Manifold
from .fit import fit, mean_errors
from .target import Target

# Evidence for these constants: ADR 036.
# Edges of a larger angle may be sharp: Hoppe et al. (1994) and modelling programs take 30 degrees or so.
LEAST_ANGLE = np.radians(30)
# On smooth shapes angled edges sharp leave a third more error than none, and what a mixture gains its marks cost.
HOPELESS = 1.15
BITS_PER_MARK = 1.9  # measured on mechanical parts; `format/surface/marks.py`
BITS_PER_VERTEX = 19.0  # of everything else, for what marks are worth


class Fitted(NamedTuple):
    """A control mesh with its sharp edges (S, 2), fitted. control: (V, 3). error: mean distance of both directions."""

    basis: Basis
    sharp: I64
    control: F64
    error: float


def fit_smooth(mesh: Manifold, target: Target, levels: int, rounds: int) -> Fitted:
    """Fit a control mesh without sharp edges but those of its boundary."""
    none = np.zeros((0, 2), dtype=np.int64)
    return _fit(mesh, none, np.zeros(0, dtype=bool), target, levels, rounds)[0]


def fit_with_creases(mesh: Manifold, target: Target, levels: int, trial_rounds: int, rounds: int) -> Fitted:
    """Fit a control mesh with the sharp edges that serve it best. rounds: more, for the fit that is chosen."""
    topology = topology_of(mesh.faces, len(mesh.vertices), np.zeros((0, 2)))
    inner = ~topology.sharp
    angled = inner & (_angles(mesh, topology.face_edges, len(topology.edges)) > LEAST_ANGLE)
    choices = [np.zeros(len(inner), dtype=bool), *([angled] if angled.any() else []), inner]
    tries: list[Fitted] = []
    around: list[F64] = []
    for marked in choices:
        one, errors = _fit(mesh, topology.edges, marked, target, levels, trial_rounds)
        tries.append(one)
        # The error around an edge: that of all faces at its ends.
        if one.error > HOPELESS * tries[0].error:
            break
        at = np.zeros(len(mesh.vertices))
        np.add.at(at, mesh.faces, errors[:, None])
        around.append(at[topology.edges].sum(axis=1))
    best = np.argmin(around, axis=0)
    mixed = np.choose(best, choices[: len(around)])
    if mixed.any() and not any(np.array_equal(mixed, marked) for marked in choices):
        tries.append(_fit(mesh, topology.edges, mixed, target, levels, trial_rounds)[0])
    # The error falls about as 1 / bytes, so that their product tells which is worth its marks.
    best_try = min(
        tries, key=lambda t: t.error * (1 + BITS_PER_MARK * len(t.sharp) / (BITS_PER_VERTEX * len(t.control)))
    )
    control = fit(best_try.basis, target, best_try.control, rounds)
    errors = mean_errors(best_try.basis, target, control)
    return best_try._replace(control=control, error=float(errors.sum()))


def _fit(mesh: Manifold, edges: I64, marked: Mask, target: Target, levels: int, rounds: int) -> tuple[Fitted, F64]:
    """Fit with some edges sharp; also the error of each control face."""
    basis = basis_of(mesh.faces, len(mesh.vertices), edges[marked], levels)
    control = fit(basis, target, mesh.vertices, rounds)
    errors = mean_errors(basis, target, control)
    return Fitted(basis, edges[marked], control, float(errors.sum())), errors


def _angles(mesh: Manifold, face_edges: I64, n_edges: int) -> F64:
    """(E,) the angle between the two faces of each edge."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    # |n1 + n2|^2 = 2 + 2 cos for two faces.
    total = np.zeros((n_edges, 3))
    for k in range(3):
        np.add.at(total, face_edges[:, k], normals)
    cosine = np.clip((total * total).sum(axis=1) / 2 - 1, -1, 1)
    return np.arccos(cosine)
