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
from ..deadline import Deadline, Pace
from ..progress import Stage
from .basis import levels_of
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
SHRINKINGS = 3  # tries with fewer vertices, while the file is too large
BALANCINGS = 2  # tries with other numbers of vertices, where that is foretold to pay
# The error of a fit falls with these powers of the number of vertices: scans .8 to 1, parts 1.2 to 2.4, and much more
# where the input's own faces are near.
FIRST_POWERS, POWERS = (1.0, 1.5), (1.0, 5.0)
ROUNDS_LEAVE = 0.9  # of the error that a few rounds leave
# Of the time of the first try: what the next takes with no further rounds, and each of these.
LEAST_TRY, ROUND_SHARE = 2.0, 0.25
# For the progress alone, ADR 044: times in rounds of the fit, and tries after the first, which mostly fills the file
# and is balanced.
ROUNDING, GRID_STEP, POLISHING, MORE_TRIES = 5, 0.4, 2, 4 / 3
COLLAPSES_AND_SPLITS, FLIPPING = 14, 22  # of a cycle of edits, in rounds


class _Try(NamedTuple):
    """A fit to a simplified mesh, and what became of it by rounding."""

    sized: Sized
    mesh: Manifold
    one: Fitted


def surface_of_size(
    given: Manifold, target: Target, size: int, settings: SurfaceSettings, stage: Stage, deadline: Deadline
) -> Sized:
    """Make the best control mesh whose section has at most `size` bytes. given: the input, cut, normalised frame."""
    tries = _Tries(given, target, size, settings, stage, deadline)
    for _ in range(SHRINKINGS):
        if tries.best.sized.n_bytes > size:
            tries.fill()
    if tries.best.sized.n_bytes > size:
        return tries.best.sized
    tries.balance()
    tries.own_faces()
    tries.fill()
    tries.others()
    return tries.edits()


class _Tries:
    """Fits of different numbers of faces, and the best of them so far."""

    def __init__(
        self,
        given: Manifold,
        target: Target,
        size: int,
        settings: SurfaceSettings,
        stage: Stage,
        deadline: Deadline,
    ) -> None:
        self._given, self._target, self._size, self._settings = given, target, size, settings
        self._deadline = deadline
        self._counts: set[int] = set()  # of faces, that were tried
        self._n_tries = 0
        self._left = 1 + len(settings.other_counts)  # tries that are foreseen, the next one included
        self._wanted = 2 * 8 * size / BITS_PER_VERTEX
        self._simplify = _Simplify(given, round(START * self._wanted))
        self._pace = Pace(deadline)
        self._work = _Work(settings, stage)
        mesh = self._simplify.to(round(self._wanted))
        simple = fit_simply(mesh, target, settings.trial_rounds)
        self._faceted = simple.faceted
        first = on_grid(simple.best, mesh, target, size, 0, final=False)
        self._work.first(simple.best, first.error)
        self._pace.done()
        self._first_time = self._pace.longest
        if deadline.left() < LEAST_TRY * self._first_time:
            raise EncodeError(
                "the time limit is too short for a surface of this size; allow more time, or use a smaller size"
            )
        self.best = self._made(self._count(self._wanted * _times(first, len(mesh.vertices), size)))

    def fill(self) -> None:
        """Another number where the file is too large, or bytes are left."""
        times = self._size / self.best.sized.n_bytes
        if times < 1 or times * CLOSE > 1:
            self._another(self._count(times * len(self.best.mesh.faces)), is_needed=times < 1)

    def own_faces(self) -> None:
        """A file that holds most of the input's own faces may hold them nearly as they are."""
        if self._wanted < OWN_FACES * len(self._given.faces):
            return
        numbers, nearly = [self._count(self._wanted)], self._count(NEARLY_ALL * len(self._given.faces))
        if self.best.sized.repeats and 2 * 8 * self._size >= LEAST_BITS * nearly:
            numbers.insert(0, nearly)
        for n_faces in numbers:
            self._another(n_faces)

    def balance(self) -> None:
        """Numbers that what rounding adds says are better."""
        powers = FIRST_POWERS
        for _ in range(BALANCINGS):
            best = self.best
            times = _balanced(best, powers, self._settings.least_foretold)
            made = self._another(self._count(times * len(best.mesh.faces)))
            if made is None:
                break
            powers = _power(best.one, made.one)

    def others(self) -> None:
        """Another number gives another mesh. On mechanical parts errors of like meshes differ by a tenth."""
        around = len(self.best.mesh.faces)
        for factor in self._settings.other_counts:
            self._left -= 1
            self._another(self._count(factor * around))
        self._work.tried(0, self.best)

    def edits(self) -> Sized:
        """The best one, or it with edges flipped, collapsed and split, where that pays."""
        (sized, mesh, one), target, settings = self.best, self._target, self._settings
        if settings.edits == 0 or not self._pace.more:
            return sized
        mesh, one = edited(
            one,
            mesh,
            target,
            one.basis.levels or levels_of(len(mesh.faces)),
            8 * self._size,
            settings.edits,
            self._deadline.before(self._pace.longest),  # what comes after takes no longer than a try
            lambda cycles, error: self._work.edited(settings.edits - cycles, one, error),
        )
        control = fit(one.basis, target, one.control, settings.trial_rounds)
        error = float(mean_errors(one.basis, target, control).sum())
        one = one._replace(control=control, error=error)
        again = on_grid(one, mesh, target, self._size, settings.grid_steps, sized.error)
        # Errors are those of the samples that were fitted: what is hardly better there may be worse elsewhere.
        is_better = again.n_bytes <= self._size and again.error < (1 - LEAST_GAIN) * sized.error
        return again if is_better else sized

    def _count(self, n_faces: float) -> int:
        return min(max(round(n_faces), LEAST_FACES), len(self._given.faces))

    def _another(self, n_faces: int, is_needed: bool = False) -> _Try | None:
        """One more try; the better is kept. None of a number that was tried, nor without time if not needed."""
        is_spare = self._n_tries < self._settings.tries and self._pace.more
        if n_faces in self._counts or not (is_spare or is_needed):
            return None
        self._work.tried(self._left, self.best)
        fits = self.best.sized.n_bytes <= self._size
        made = self._made(n_faces, self.best.sized.error if fits else math.inf)
        self.best = min(self.best, made, key=lambda one: one.sized.rank(self._size))
        return made

    def _made(self, n_faces: int, least: float = math.inf) -> _Try:
        """A try; where it has no hope of less than the least error, it is left unfinished."""
        settings, target = self._settings, self._target
        self._n_tries += 1
        # Further rounds are for what is left after a try without them.
        spare = max(self._deadline.left() - LEAST_TRY * self._first_time, 0.0)
        rounds = int(min(settings.rounds, spare / (ROUND_SHARE * self._first_time)))
        mesh = self._simplify.to(n_faces)
        self._counts.update((n_faces, len(mesh.faces)))  # it may have a face or two less
        faceted = self._faceted or n_faces == len(self._given.faces)
        one = fit_with_creases(mesh, target, settings.trial_rounds, rounds, faceted)
        made = _Try(on_grid(one, mesh, target, self._size, settings.grid_steps, least), mesh, one)
        self._pace.done()
        return made


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
        return 3 * self._settings.trial_rounds + self._settings.rounds + self._on_grid(smooth)

    def _on_grid(self, smooth: float) -> float:
        rounding: float = ROUNDING + POLISHING
        if smooth < MOSTLY_SMOOTH:  # with a price, too
            rounding = 2 * (rounding + GRID_STEP * self._settings.grid_steps)
        return rounding

    def _left(self, tries: float, cycles: int, smooth: float) -> float:
        after = self._settings.trial_rounds + self._on_grid(smooth) if self._settings.edits else 0
        return self._try(smooth) * tries + _cycle(smooth) * cycles + after


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


def _times(first: Sized, n_vertices: int, size: int) -> float:
    """How many times as many vertices a file of `size` bytes holds as the first try has. With more rounds and vertices
    the error is less, and so the step finer: by the square root of it."""
    x0 = size / first.n_bytes
    bits = 8 * first.n_bytes / n_vertices
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
    bits = 8 * best.sized.n_bytes / len(best.one.control)
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
