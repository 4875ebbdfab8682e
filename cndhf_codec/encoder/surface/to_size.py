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
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...arrays import I64
from ...errors import EncodeError
from ...format import ControlMesh
from ...format.bfloat16 import above
from ...format.surface.section import UNTURNED, PositionEncoder
from ..deadline import Deadline, Pace
from ..progress import Stage
from .creases import Fitted, fit_smooth, fit_with_creases
from .cut import Manifold, cut
from .edits import LEAST_GAIN, edited
from .fit import fit, mean_errors
from .rounding import Rounding, polished
from .settings import SurfaceSettings
from .simplify import Simplifier
from .target import Target

# Evidence for these constants: ADR 036.
BITS_PER_VERTEX = 18.0  # of the first try only
CLOSE = 0.985  # a file of this share of the bytes allowed is full
LEAST_FACES = 4
START = 4.0  # the first simplification leaves so many times as many faces as the first try has
TRIES = 3  # with other numbers of vertices
STEP_TRIES = 4  # with other steps, for one number of vertices
LAST_STEP_TRIES = 12  # where it may be any: flat surfaces save less than a bit per coordinate and halving
POLISHED = 2 / 3  # what polishing leaves of the error of rounding, and so of u
MOST_COARSER = 3.0  # the step may differ from the formula by this factor, to fill a file
# Of the time of the first try: what the next takes with no further rounds, and each of these.
LEAST_TRY, ROUND_SHARE = 2.0, 0.25
ROUNDING, POLISHING = 5, 2  # times in rounds of the fit: for the progress alone, ADR 044
FINE_FACES = 20_000  # the tessellation has about so many faces; of twice as many, 1 KiB has 0.5 % less error
LEAST_LEVELS = 2  # with one, quadratic patches are still too far off: igea at 2 KiB 1.09, with two 1.05


class Sized(NamedTuple):
    """A control mesh and the bytes of its section. error: mean distance; after rounding, but for
    a first try."""

    mesh: ControlMesh
    body: bytes
    error: float


def surface_of_size(
    given: Manifold, target: Target, size: int, settings: SurfaceSettings, stage: Stage, deadline: Deadline
) -> Sized:
    """Make the best control mesh whose section has at most `size` bytes. given: the input, cut, normalised frame."""
    wanted = 2 * 8 * size / BITS_PER_VERTEX
    others = settings.other_counts
    simplify = _Simplify(given, round(START * wanted))
    work = _Work(settings, wanted, stage)
    best: tuple[Sized, Manifold, Fitted] | None = None
    pace, rounds, first = Pace(deadline), settings.rounds, 0.0
    for k in range(TRIES):
        mesh = simplify.to(round(wanted))
        final = k > 0
        if final:
            one = fit_with_creases(mesh, target, _levels(mesh), settings.trial_rounds, rounds)
        else:
            one = fit_smooth(mesh, target, _levels(mesh), settings.trial_rounds)
        # The last try may take any coarser step, rather than make no file.
        coarsest = math.inf if k == TRIES - 1 and best is None else MOST_COARSER
        sized = _rounded(one, mesh, target, size, coarsest, final)
        work(k + 1, 0, 0, one, sized.error)
        whole = len(mesh.faces) >= len(given.faces)
        if len(sized.body) <= size and final and (best is None or sized.error < best[0].error):
            best = sized, mesh, one
        full = CLOSE * size <= len(sized.body) <= size
        pace.done()
        if final and (full or (whole and len(sized.body) <= size) or (best is not None and not pace.more)):
            break
        if k == 0:
            first = pace.last
            if deadline.left() < LEAST_TRY * first:
                raise EncodeError(
                    "the time limit is too short for a surface of this size; allow more time, or use a smaller size"
                )
        left = max(deadline.left() - LEAST_TRY * first, 0.0)
        rounds = int(min(settings.rounds, left / (ROUND_SHARE * first)))
        wanted = min(max(wanted * size / len(sized.body), LEAST_FACES), len(given.faces))
    if best is None:
        return sized
    # Another number of vertices gives another mesh. On mechanical parts errors of like meshes differ by a tenth.
    around = len(best[1].faces)
    for k, factor in enumerate(others):
        if not pace.more:
            break
        mesh = simplify.to(round(factor * around))
        one = fit_with_creases(mesh, target, _levels(mesh), settings.trial_rounds, rounds)
        sized = _rounded(one, mesh, target, size)
        work(TRIES, k + 1, 0, one, sized.error)
        pace.done()
        if len(sized.body) <= size and sized.error < best[0].error:
            best = sized, mesh, one
    sized, mesh, one = best
    if settings.edits == 0 or not pace.more:
        return sized
    mesh, one = edited(
        one,
        mesh,
        target,
        _levels(mesh),
        8 * size,
        settings.edits,
        deadline.before(pace.last),  # what comes after takes no longer than a try
        lambda cycles, error: work(TRIES, len(others), cycles, one, error),
    )
    control = fit(one.basis, target, one.control, settings.trial_rounds)
    error = float(mean_errors(one.basis, target, control).sum())
    again = _rounded(one._replace(control=control, error=error), mesh, target, size)
    # Errors are those of the samples that were fitted: what is hardly better there may be worse elsewhere.
    return again if len(again.body) <= size and again.error < (1 - LEAST_GAIN) * sized.error else sized


class _Work:
    """Tells how much is done, in rounds of the fit, which take equally long."""

    def __init__(self, settings: SurfaceSettings, faces: float, stage: Stage) -> None:
        """faces: that the control mesh is expected to have."""
        self._settings = settings
        self._total = round(self._rounds(1.5 * faces))
        self._on_step = stage("fit", self._total)

    def __call__(self, tries: int, others: int, cycles: int, one: Fitted, error: float) -> None:
        """Tell of the first tries, those with other counts, and cycles of edits that are over. one: the last fit."""
        smooth = 3 * len(one.control) - len(one.sharp)
        share = self._rounds(smooth, tries, others, cycles) / self._rounds(smooth)
        self._on_step(round(share * self._total), error)

    def _rounds(self, smooth: float, tries: int = TRIES, others: int = -1, cycles: int = -1) -> float:
        """By default all. smooth: edges that are; the more, the longer is a cycle of edits."""
        s = self._settings
        first, later = s.trial_rounds + ROUNDING, 3 * s.trial_rounds + s.rounds + ROUNDING + POLISHING
        last = first if s.edits and cycles < 0 else 0
        others, cycles = len(s.other_counts) if others < 0 else others, s.edits if cycles < 0 else cycles
        # The second try mostly fills the file, so the third counts a third.
        return first + later * ((tries > 1) + (tries > 2) / 3 + others) + math.sqrt(max(smooth, 1)) * cycles + last


class _Simplify:
    """Simplifies a mesh to any number of faces, from a first simplification where it is fine enough."""

    def __init__(self, given: Manifold, n_faces: int) -> None:
        self._given = given
        self._start = Simplifier.of(given.vertices, given.faces)
        self._start.to(n_faces)

    def to(self, n_faces: int) -> Manifold:
        given = self._given
        if n_faces >= len(given.faces):
            return given
        coarse = n_faces <= self._start.n_faces
        less = (self._start.copy() if coarse else Simplifier.of(given.vertices, given.faces)).to(n_faces)
        return cut(less.vertices, less.faces)


def _levels(mesh: Manifold) -> int:
    return min(max(round(math.log(FINE_FACES / len(mesh.faces), 4)), LEAST_LEVELS), 4)


def _rounded(
    one: Fitted, mesh: Manifold, target: Target, size: int, coarsest: float = MOST_COARSER, final: bool = True
) -> Sized:
    """Round to the step of the formula, or one a little coarser or finer that fills the file. coarsest: by what factor
    the step may be coarser. final: whether more is asked for than the bytes."""
    rounding = Rounding(one.basis, target, one.control)
    left = one.control.size / (math.log(2) * 8 * size)
    stiffness = POLISHED * rounding.stiffness / min(max(rounding.median / rounding.mean, left), 1)
    ideal = math.sqrt(12 * max(one.error, 1e-7) / (math.log(2) * stiffness * 8 * size))
    blank = ControlMesh(
        UNTURNED,
        1.0,
        np.zeros(one.control.shape, dtype=np.int32),
        mesh.faces.astype(np.int32),
        one.sharp.astype(np.int32),
    )
    encoder = PositionEncoder(blank)

    def at(step: float, grid: I64) -> Sized:
        control = replace(blank, step=step, positions=grid.astype(np.int32))
        return Sized(control, encoder.body(control), math.nan)

    step, best = ideal, None
    for _ in range(STEP_TRIES if coarsest < math.inf else LAST_STEP_TRIES):
        step = above(min(max(step, 2.0**-17), 0.1))
        made = at(step, rounding.to(step))
        n_bytes = len(made.body)
        if best is None or (n_bytes <= size and (len(best.body) > size or n_bytes > len(best.body))):
            best = made
        if CLOSE * size <= n_bytes <= size:
            break
        # A bit more of each coordinate halves the step.
        bits = 8 * (0.995 * size - n_bytes)
        step = step * 2.0 ** (-bits / (3 * len(one.control)))
        if not ideal / MOST_COARSER <= step <= ideal * coarsest:
            step = min(max(step, ideal / MOST_COARSER), ideal * coarsest)
            if above(step) == made.mesh.step:
                break
    assert best is not None
    if not final:
        return best._replace(error=one.error)
    # Polishing changes the bytes by a few thousandths; a little coarser they fit again.
    for coarser in (1.0, 1.01):
        step = above(best.mesh.step * coarser)
        grid = best.mesh.positions.astype(np.int64) if coarser == 1 else rounding.to(step)
        made = at(step, polished(one.basis, target, grid, step))
        if len(made.body) <= max(size, len(best.body)):
            best = made
            break
    return best._replace(error=float(mean_errors(one.basis, target, best.mesh.vertices).sum()))
