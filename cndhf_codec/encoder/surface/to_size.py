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

Where the error falls faster than 1 / bits, near the input's own faces, this leaves too many vertices. What rounding
really adds tells, and then other numbers are tried (`_balanced`); and that of the input's own faces, where a file can
hold about as many.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...errors import EncodeError
from ...format.surface.section import REPEATS
from ..deadline import Deadline, Pace
from ..progress import Stage
from .creases import Fitted, fit_simply, fit_with_creases
from .cut import Manifold, cut
from .edits import LEAST_GAIN, edited
from .fit import fit, mean_errors
from .grid import CLOSE, FINEST, MOSTLY_SMOOTH, Sized, on_grid, smooth_share
from .settings import SurfaceSettings
from .simplify import Simplifier
from .target import Target

# Evidence for these constants: ADR 036.
BITS_PER_VERTEX = 18.0  # of the first try only
LEAST_FACES = 4
START = 4.0  # the first simplification leaves so many times as many faces as the first try has
OWN_FACES = 0.5  # share of the input's faces
# Without its flattest faces an input is nearly itself; a vertex whose coordinates repeat may take so few bits on a grid
# that is fine enough for it.
NEARLY_ALL, LEAST_BITS = 0.9, 13
REFILLS = 1  # further tries, where the first file is too large, or not full
BALANCINGS = 2  # tries with other numbers of vertices, where that is foretold to pay
# The error of a fit falls with these powers of the number of vertices: scans .8 to 1, parts 1.2 to 2.4, and much more
# where the input's own faces are near.
FIRST_POWERS, POWERS = (1.0, 1.5), (1.0, 5.0)
ROUNDS_LEAVE = 0.9  # of the error that a few rounds leave
# Of the time of the first try: what the next takes with no further rounds, and each of these.
LEAST_TRY, ROUND_SHARE = 2.0, 0.25
# For the progress alone, ADR 044: times in rounds of the fit, and tries after the first, which mostly fills the file
# and is balanced.
ROUNDING, GRID_STEP, POLISHING, MORE_TRIES = 5, 0.7, 2, 4 / 3
COLLAPSES_AND_SPLITS, FLIPPING = 14, 22  # of a cycle of edits, in rounds
FINE_FACES = 20_000  # the tessellation has about so many faces; of twice as many, 1 KiB has 0.5 % less error
LEAST_LEVELS = 2  # with one, quadratic patches are still too far off: igea at 2 KiB 1.09, with two 1.05


class _Try(NamedTuple):
    """A fit to a simplified mesh, and what became of it by rounding."""

    sized: Sized
    mesh: Manifold
    one: Fitted


def surface_of_size(
    given: Manifold, target: Target, size: int, settings: SurfaceSettings, stage: Stage, deadline: Deadline
) -> Sized:
    """Make the best control mesh whose section has at most `size` bytes. given: the input, cut, normalised frame."""
    wanted = 2 * 8 * size / BITS_PER_VERTEX
    simplify = _Simplify(given, round(START * wanted))
    work = _Work(settings, stage)
    pace = Pace(deadline)
    mesh = simplify.to(round(wanted))
    simple = fit_simply(mesh, target, _levels(mesh), settings.trial_rounds)
    first = on_grid(simple.best, mesh, target, size, 0, final=False)
    work.first(simple.best, first.error)
    pace.done()
    first_time = pace.last
    if deadline.left() < LEAST_TRY * first_time:
        raise EncodeError(
            "the time limit is too short for a surface of this size; allow more time, or use a smaller size"
        )

    counts: set[int] = set()  # of faces, that were tried

    def count(n_faces: float) -> int:
        return min(max(round(n_faces), LEAST_FACES), len(given.faces))

    def tried(n_faces: int) -> _Try:
        # Further rounds are for what is left after a try without them.
        spare = max(deadline.left() - LEAST_TRY * first_time, 0.0)
        rounds = int(min(settings.rounds, spare / (ROUND_SHARE * first_time)))
        mesh = simplify.to(n_faces)
        counts.update((n_faces, len(mesh.faces)))  # it may have a face or two less
        faceted = simple.faceted or n_faces == len(given.faces)
        one = fit_with_creases(mesh, target, _levels(mesh), settings.trial_rounds, rounds, faceted)
        made = _Try(on_grid(one, mesh, target, size, settings.grid_steps), mesh, one)
        pace.done()
        return made

    others = len(settings.other_counts)
    best = tried(count(wanted * _times(first, len(mesh.vertices), size)))
    for _ in range(REFILLS):
        n_bytes = len(best.sized.body)
        n_faces = count(len(best.mesh.faces) * size / n_bytes)
        if n_faces in counts or (n_bytes <= size and (n_bytes >= CLOSE * size or not pace.more)):
            break
        work.tried(1 + others, best)
        best = _better(best, tried(n_faces), size)
    # A file that holds most of the input's own faces may hold them nearly as they are.
    if wanted >= OWN_FACES * len(given.faces):
        owns, nearly = [count(wanted)], count(NEARLY_ALL * len(given.faces))
        if best.sized.body[0] & REPEATS and 2 * 8 * size >= LEAST_BITS * nearly:
            owns.append(nearly)
        for own in owns:
            if own not in counts and pace.more:
                work.tried(1 + others, best)
                best = _better(best, tried(own), size)
    if len(best.sized.body) > size:
        return best.sized
    powers = FIRST_POWERS
    for _ in range(BALANCINGS):
        n_faces = count(_balanced(best, powers, settings.least_foretold) * len(best.mesh.faces))
        if n_faces in counts or not pace.more:
            break
        work.tried(1 + others, best)
        made = tried(n_faces)
        powers = _power(best.one, made.one)
        best = _better(best, made, size)
    # Another number of vertices gives another mesh. On mechanical parts errors of like meshes differ by a tenth.
    around = len(best.mesh.faces)
    for k, factor in enumerate(settings.other_counts):
        n_faces = count(factor * around)
        if n_faces in counts or not pace.more:
            continue
        work.tried(others - k, best)
        best = _better(best, tried(n_faces), size)
    work.tried(0, best)
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
        lambda cycles, error: work.edited(settings.edits - cycles, one, error),
    )
    control = fit(one.basis, target, one.control, settings.trial_rounds)
    error = float(mean_errors(one.basis, target, control).sum())
    again = on_grid(one._replace(control=control, error=error), mesh, target, size, settings.grid_steps)
    # Errors are those of the samples that were fitted: what is hardly better there may be worse elsewhere.
    return again if len(again.body) <= size and again.error < (1 - LEAST_GAIN) * sized.error else sized


class _Work:
    """Tells how much is done, in rounds of the fit, which take equally long."""

    def __init__(self, settings: SurfaceSettings, stage: Stage) -> None:
        s = self._settings = settings
        self._first = 2 * s.trial_rounds + ROUNDING
        self._spent, self._share, self._error = 0.0, 0.0, 0.0
        self._total = round(self._first + self._left(MORE_TRIES + len(s.other_counts), s.edits, 1.0))
        self._on_step = stage("fit", self._total)

    def first(self, one: Fitted, error: float) -> None:
        self._tell(self._first, MORE_TRIES + len(self._settings.other_counts), self._settings.edits, one, error)

    def tried(self, tries: int, best: _Try) -> None:
        """After each try, when it is known how many are left."""
        self._error = best.one.error
        self._tell(self._try(smooth_share(best.one)), tries, self._settings.edits, best.one, best.sized.error)

    def edited(self, cycles: int, one: Fitted, error: float) -> None:
        """cycles: that may be left. The less the last one gained, the sooner they end."""
        gain, self._error = 1 - error / max(self._error, 1e-12), error
        self._tell(_cycle(smooth_share(one)), 0, min(cycles, math.ceil(max(gain, 0) / LEAST_GAIN)), one, error)

    def _tell(self, spent: float, tries: float, cycles: int, one: Fitted, error: float) -> None:
        self._spent += spent
        share = self._spent / (self._spent + self._left(tries, cycles, smooth_share(one)))
        # One fit may have more smooth edges than the one before, or a try was not foreseen.
        self._share = max(self._share, share)
        self._on_step(round(self._share * self._total), error)

    def _try(self, smooth: float) -> float:
        s = self._settings
        rounding: float = ROUNDING + POLISHING
        if smooth < MOSTLY_SMOOTH:
            rounding += ROUNDING + POLISHING + 2 * GRID_STEP * s.grid_steps  # with a price, too
        return 3 * s.trial_rounds + s.rounds + rounding

    def _left(self, tries: float, cycles: int, smooth: float) -> float:
        return self._try(smooth) * tries + _cycle(smooth) * cycles + (self._first if self._settings.edits else 0)


def _cycle(smooth: float) -> float:
    """All edges are collapsed and split, but only smooth ones flipped."""
    return COLLAPSES_AND_SPLITS + FLIPPING * smooth


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


def _better(best: _Try, other: _Try, size: int) -> _Try:
    """Of less error, if both fit; else the one that fits, or is smaller."""
    return min(best, other, key=lambda one: (max(len(one.sized.body), size), one.sized.error))


def _times(first: Sized, n_vertices: int, size: int) -> float:
    """How many times as many vertices a file of `size` bytes holds as the first try has. With more rounds and vertices
    the error is less, and so the step finer: by the square root of it."""
    x0 = size / len(first.body)
    bits = 8 * len(first.body) / n_vertices
    x = x0
    for _ in range(10):
        x = x0 / max(1 + 1.5 * math.log2(max(x / ROUNDS_LEAVE, 0.1)) / bits, 0.5)
    return x


def _balanced(best: _Try, powers: tuple[float, float], least_foretold: float) -> float:
    """How many times as many vertices would be better; 1 where that takes less than a share off the error.

    Error f of the fit and noise n of rounding make about sqrt(f^2 + n^2). x times the vertices leave x^-p of f, and of
    b bits per vertex b / x, which make n 2^(b / 3 (1 - 1 / x)) times as large. powers: the least and the largest p.
    """
    f, error = best.one.error, best.sized.error
    noise = math.sqrt(max(error * error - f * f, 0.0))
    bits = 8 * len(best.sized.body) / len(best.one.control)
    x = 2.0 ** np.linspace(-1, 1, 81)
    noises = noise * np.maximum(2.0 ** (bits / 3 * (1 - 1 / x)), FINEST / best.sized.mesh.step)
    foretold = np.hypot(f * np.maximum(x ** -powers[0], x ** -powers[1]), noises)
    least = int(np.argmin(foretold))
    return float(x[least]) if foretold[least] < (1 - least_foretold) * error else 1.0


def _power(one: Fitted, other: Fitted) -> tuple[float, float]:
    """With which power of the number of vertices the error of the fit falls, as two fits tell."""
    vertices = math.log(len(one.control) / len(other.control))
    power = math.log(max(other.error, 1e-12) / max(one.error, 1e-12)) / (vertices or 1.0)
    power = min(max(power, POWERS[0]), POWERS[1])
    return power, power


def _levels(mesh: Manifold) -> int:
    return min(max(round(math.log(FINE_FACES / len(mesh.faces), 4)), LEAST_LEVELS), 4)
