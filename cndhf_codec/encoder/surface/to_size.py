"""Find the number of control vertices and the grid's step that make the best file of at most so many bytes.

A finer grid costs bits that more vertices would use, too. At the best balance, a bit spent either way lowers the error
by as much. The error falls about as 1 / bits, so a bit of more vertices is worth error / bits. Rounding n coordinates
to a grid of step h adds n u h^2 / 24 to the error, where u is the stiffness of a coordinate that the others make up
for (`rounding.py`); a bit for one of them takes ln(2) u h^2 / 12 off. So

    h^2 = 12 error / (ln(2) u bits)

On mechanical parts most of the surface is met almost exactly, and the mean is that of a few places. There the density
of distances at zero, and with it u, is that of the median, mean / median times as large; but no larger than the
distances that rounding itself leaves allow. These are r with r^2 / (2 mean) = n u h^2 / 24, and with the h from above
r / mean is n / (ln(2) bits) for this larger u.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...format import ControlMesh
from ...format.surface.section import UNTURNED, encode_surface
from ..deadline import Deadline
from ..progress import Stage
from .creases import Fitted, fit_smooth, fit_with_creases
from .cut import Manifold, cut
from .rounding import Rounding
from .settings import SurfaceSettings
from .simplify import Simplifier
from .target import Target

# Evidence for these constants: ADR 036.
BITS_PER_VERTEX = 18.0  # of the first try only
CLOSE = 0.985  # a file of this share of the bytes allowed is full
LEAST_FACES = 4
TRIES = 3  # with other numbers of vertices
STEP_TRIES = 4  # with other steps, for one number of vertices
LAST_STEP_TRIES = 12  # where it may be any: flat surfaces save less than a bit per coordinate and halving
MOST_COARSER = 3.0  # the step may differ from the formula by this factor, to fill a file
FINE_FACES = 40_000  # the tessellation has about so many faces: as many as there are samples
# With one level, the chords of the tessellation are as far off as the fit: horse at 8 KiB 0.226, with two 0.153.
LEAST_LEVELS = 2


class Sized(NamedTuple):
    """A control mesh and the bytes of its section. error: mean distance, of the fit before rounding."""

    mesh: ControlMesh
    body: bytes
    error: float


def surface_of_size(
    given: Manifold, target: Target, size: int, settings: SurfaceSettings, stage: Stage, deadline: Deadline
) -> Sized:
    """Make the best control mesh whose section has at most `size` bytes. given: the input, cut, normalised frame."""
    wanted = 2 * 8 * size / BITS_PER_VERTEX
    on_step = stage("fit", TRIES)
    best: Sized | None = None
    for k in range(TRIES):
        mesh = _simplified(given, round(wanted))
        final = k > 0
        if final:
            one = fit_with_creases(mesh, target, _levels(mesh), settings.trial_rounds, settings.rounds)
        else:
            one = fit_smooth(mesh, target, _levels(mesh), settings.trial_rounds)
        # The last try may take any coarser step, rather than make no file.
        coarsest = math.inf if k == TRIES - 1 and best is None else MOST_COARSER
        sized = _rounded(one, mesh, target, size, coarsest)
        on_step(k + 1, sized.error)
        whole = len(mesh.faces) >= len(given.faces)
        if len(sized.body) <= size and final and (best is None or sized.error < best.error):
            best = sized
        full = CLOSE * size <= len(sized.body) <= size
        if final and (full or (whole and len(sized.body) <= size) or deadline.passed() >= 1):
            break
        wanted = min(max(wanted * size / len(sized.body), LEAST_FACES), len(given.faces))
    if best is None:
        best = sized
    return best


def _simplified(given: Manifold, n_faces: int) -> Manifold:
    if n_faces >= len(given.faces):
        return given
    less = Simplifier(given.vertices, given.faces).to(n_faces)
    return cut(less.vertices, less.faces)


def _levels(mesh: Manifold) -> int:
    return min(max(round(math.log(FINE_FACES / len(mesh.faces), 4)), LEAST_LEVELS), 4)


def _rounded(one: Fitted, mesh: Manifold, target: Target, size: int, coarsest: float) -> Sized:
    """Round to the step of the formula, or one a little coarser or finer that fills the file. coarsest: by what factor
    the step may be coarser."""
    rounding = Rounding(one.basis, target, one.control)
    left = one.control.size / (math.log(2) * 8 * size)
    stiffness = rounding.stiffness / min(max(rounding.median / rounding.mean, left), 1)
    ideal = math.sqrt(12 * max(one.error, 1e-7) / (math.log(2) * stiffness * 8 * size))
    step, best = ideal, None
    for _ in range(STEP_TRIES if coarsest < math.inf else LAST_STEP_TRIES):
        step = float(np.float32(min(max(step, 2.0**-17), 0.1)))
        control = ControlMesh(
            UNTURNED,
            step,
            rounding.to(step).astype(np.int32),
            mesh.faces.astype(np.int32),
            one.sharp.astype(np.int32),
        )
        body = encode_surface(control)
        fits = len(body) <= size
        if best is None or (fits and (len(best.body) > size or len(body) > len(best.body))):
            best = Sized(control, body, one.error)
        if CLOSE * size <= len(body) <= size:
            break
        # A bit more of each coordinate halves the step.
        bits = 8 * (0.995 * size - len(body))
        step = step * 2.0 ** (-bits / (3 * len(one.control)))
        if not ideal / MOST_COARSER <= step <= ideal * coarsest:
            step = min(max(step, ideal / MOST_COARSER), ideal * coarsest)
            if abs(math.log(step / control.step)) < 1e-3:
                break
    assert best is not None
    return best
