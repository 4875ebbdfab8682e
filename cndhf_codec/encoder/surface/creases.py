"""Choose the edges that are sharp, by what they do to the error.

Up to three fits are made: with no sharp edge, with those of a large angle between their faces, with all (a polyhedron).
Each edge is then sharp where the fit in which it is leaves less error around it, by more than a mark is worth. Where
that mixture pays for its marks, it is taken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import F64, I64, Mask
from ...decoder.surface.subdivision import topology_of
from ...format.surface.marks import encode_marks
from ...format.surface.range_coder import RangeEncoder
from ...mesh.sampling import area_normals
from .basis import Basis, coarsest_basis
from .cut import Manifold
from .fit import fit, mean_errors
from .target import Target

# Evidence for these constants: ADR 036.
# Edges of a larger angle may be sharp: Hoppe et al. (1994) and modelling programs take 30 degrees or so.
LEAST_ANGLE = np.radians(30)
# On smooth shapes angled edges sharp leave a third more error than none, and what a mixture gains its marks cost. All
# sharp, too, are not tried where a polyhedron was so much worse (`Simple.faceted`).
HOPELESS = 1.15
BITS_PER_VERTEX = 19.0  # of everything but marks, for what these are worth
# Bits that an edge must gain by being sharp: its own, and more, for the errors around it are those of samples, and fall
# by what the marks of its neighbours do.
MARK_BITS = 15.0
LEAST_ERROR = 1e-7  # less is as good as none: a thousandth of the finest step


class Fitted(NamedTuple):
    """A control mesh with its sharp edges (S, 2), fitted. control: (V, 3). error: mean distance of both directions."""

    basis: Basis
    sharp: I64
    control: F64
    error: float


class Simple(NamedTuple):
    """The better one of two fits: without sharp edges, and with all sharp. faceted: whether the latter has an error not
    far above the former's, so that some edges may be better sharp for that reason alone."""

    best: Fitted
    faceted: bool


def fit_simply(mesh: Manifold, target: Target, rounds: int) -> Simple:
    """Fit a control mesh without sharp edges but those of its boundary, and as a polyhedron."""
    topology = topology_of(mesh.faces, len(mesh.vertices), np.zeros((0, 2)))
    inner = ~topology.sharp
    none, faces = (_fit(mesh, topology.edges, marked, target, rounds)[0] for marked in (np.zeros_like(inner), inner))
    return Simple(faces if faces.error < none.error else none, faces.error <= HOPELESS * none.error)


def fit_with_creases(mesh: Manifold, target: Target, trial_rounds: int, rounds: int, faceted: bool) -> Fitted:
    """Fit a control mesh with the sharp edges that serve it best. rounds: more, for the fit that is chosen. faceted:
    whether all may be sharp (`Simple`)."""
    topology = topology_of(mesh.faces, len(mesh.vertices), np.zeros((0, 2)))
    inner = ~topology.sharp
    angled = inner & (_angles(mesh, topology.face_edges, len(topology.edges)) > LEAST_ANGLE)
    choices = [np.zeros(len(inner), dtype=bool), *([angled] if angled.any() else []), *([inner] if faceted else [])]
    tries: list[Fitted] = []
    around: list[F64] = []
    hopeful: list[Mask] = []
    for marked in choices:
        one, errors = _fit(mesh, topology.edges, marked, target, trial_rounds)
        tries.append(one)
        if one.error > HOPELESS * tries[0].error:
            continue
        # The error around an edge: that of all faces at its ends.
        at = np.zeros(len(mesh.vertices))
        np.add.at(at, mesh.faces, errors[:, None])
        around.append(at[topology.edges].sum(axis=1))
        hopeful.append(marked)
    choices = hopeful
    bit = min(_known(one) for one in tries) / (BITS_PER_VERTEX * len(mesh.vertices))
    best = np.argmin(np.array(around) + MARK_BITS * bit * np.array(choices), axis=0)
    mixed = np.choose(best, choices)
    if mixed.any() and not any(np.array_equal(mixed, marked) for marked in choices):
        tries.append(_fit(mesh, topology.edges, mixed, target, trial_rounds)[0])
    # The error falls about as 1 / bits, so that their product tells which is worth its marks.
    best_try = min(
        tries, key=lambda t: _known(t) * (1 + _mark_bits(mesh, t.sharp) / (BITS_PER_VERTEX * len(t.control)))
    )
    control = fit(best_try.basis, target, best_try.control, rounds)
    errors = mean_errors(best_try.basis, target, control)
    return best_try._replace(control=control, error=float(errors.sum()))


def _fit(mesh: Manifold, edges: I64, marked: Mask, target: Target, rounds: int) -> tuple[Fitted, F64]:
    """Fit with some edges sharp; also the error of each control face."""
    basis = coarsest_basis(mesh.faces, len(mesh.vertices), edges[marked])
    control = fit(basis, target, mesh.vertices, rounds)
    errors = mean_errors(basis, target, control)
    return Fitted(basis, edges[marked], control, float(errors.sum())), errors


def _known(one: Fitted) -> float:
    """The error, as far as it is more than noise: of parts that are met exactly, marks decide."""
    return max(one.error, LEAST_ERROR)


def _mark_bits(mesh: Manifold, sharp: I64) -> int:
    """What the marks take in a file; nothing in a polyhedron, all of whose edges are sharp."""
    encoder = RangeEncoder()
    encode_marks(encoder, mesh.faces.astype(np.int32), sharp.astype(np.int32))
    return 8 * len(encoder.finish())


def _angles(mesh: Manifold, face_edges: I64, n_edges: int) -> F64:
    """(E,) the angle between the two faces of each edge."""
    cross = area_normals(mesh.vertices, mesh.faces)
    normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    # |n1 + n2|^2 = 2 + 2 cos for two faces.
    total = np.zeros((n_edges, 3))
    for k in range(3):
        np.add.at(total, face_edges[:, k], normals)
    cosine = np.clip((total * total).sum(axis=1) / 2 - 1, -1, 1)
    return np.arccos(cosine)
