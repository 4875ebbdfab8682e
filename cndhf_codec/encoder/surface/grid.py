"""Put a fit on the grid: the step that fills a file, the rounding, and what still moves then."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from ...arrays import I64
from ...format import ControlMesh
from ...format.bfloat16 import above
from ...format.surface.section import UNTURNED
from .coded_size import SectionSizes
from .creases import Fitted
from .cut import Manifold
from .fit import mean_errors
from .rounding import Rounding, polished
from .target import Target

# Evidence for these constants: ADR 036.
CLOSE = 0.985  # a file of this share of the bytes allowed is full
STEP_TRIES = 12  # flat surfaces save less than a bit per coordinate and halving of the step
POLISHED = 0.8  # what polishing leaves of the error of rounding, and so of u
NEXT_STEP = 1 + 2.0**-9  # a bfloat16 times this is below the next one
# What a repeated coordinate saves: this share of the bytes is positions, and the bits tell that it is one.
POSITIONS_SHARE, TOLD_BITS = 0.8, 1.5
POWER = 1.5  # of the number of bits, with which errors of mechanical parts fall
MOSTLY_SMOOTH = 0.9  # share of the edges
FINEST, COARSEST = 2.0**-17, 0.1  # steps: the finest is less than a thousandth of a percent of the diagonal
OUT_OF_REACH = 1.6  # times the best error: next steps and polishing take less off, .35 at most
NARROW = 1.02  # between steps so near each other there is nothing to be found
FEWER = 4  # of so many samples one is enough to choose among steps
MOST_FINER = 3.0  # than the formula's the step may be, to fill a file


class Sized(NamedTuple):
    """A control mesh. n_bytes: of its section. repeats: whether that says repeated coordinates. error: mean distance;
    after rounding, but for a first try."""

    mesh: ControlMesh
    n_bytes: int
    repeats: bool
    error: float

    def rank(self, size: int) -> tuple[int, float]:
        """Less is better: of less error, if both fit into `size` bytes; else what fits, or is smaller."""
        return max(self.n_bytes, size), self.error


def on_grid(
    one: Fitted, mesh: Manifold, target: Target, size: int, steps: int, best: float = math.inf, final: bool = True
) -> Sized:
    """The best file of a fit, of at most `size` bytes if one is.

    The step is that of the formula of `to_size.py`, or one that fills the file: any coarser one, or one a little finer.
    Where edges are sharp, so many of the next coarser `steps` are tried: flat faces are met or missed as a whole, by
    where they lie on the grid, so that steps a hundredth apart have errors a tenth apart. The best is polished, if
    that pays. Where coordinates repeat, all of this is tried with more of them, too. best: an error to be less than;
    what has no hope of it is left as it is rounded. final: whether more is asked for than the bytes at the formula's
    step.
    """
    grids = _Grids(one, mesh, target, size)
    if not final:
        return grids.filled(grids.ideal, 0.0, tries=1)._replace(error=one.error)
    filled = grids.filled(grids.ideal, 0.0)
    steps = steps if smooth_share(one) < MOSTLY_SMOOTH else 0
    most = best * OUT_OF_REACH
    made = grids.polished(filled, 0.0, steps, most)
    if filled.repeats:
        price = grids.price()
        other = grids.polished(grids.filled(filled.mesh.step, price), price, steps, most)
        made = min(made, other, key=lambda sized: sized.rank(size))
    return made


def smooth_share(one: Fitted) -> float:
    """The share of the edges that are not sharp."""
    return max(1 - len(one.sharp) / (3 * len(one.control)), 0.0)


class _Grids:
    """One fit, on any grid. ideal: the formula's step."""

    def __init__(self, one: Fitted, mesh: Manifold, target: Target, size: int) -> None:
        self._one, self._target, self._few, self._size = one, target, target.every(FEWER), size
        self._rounding = rounding = Rounding(one.basis, target, one.control)
        left = one.control.size / (math.log(2) * 8 * size)
        stiffness = POLISHED * rounding.stiffness / min(max(rounding.median / rounding.mean, left), 1)
        self.ideal = math.sqrt(12 * max(one.error, 1e-7) / (math.log(2) * stiffness * 8 * size))
        self._blank = ControlMesh(
            UNTURNED,
            1.0,
            np.zeros(one.control.shape, dtype=np.int32),
            mesh.faces.astype(np.int32),
            one.sharp.astype(np.int32),
        )
        self._sizes = SectionSizes(self._blank)

    def price(self) -> float:
        """What a coordinate may cost that no neighbour has, of mean distance: its bits would lower that elsewhere."""
        saved = POSITIONS_SHARE * 8 * self._size / self._one.control.size - TOLD_BITS
        return POWER * max(saved, 0.0) * self._one.error / (8 * self._size)

    def filled(self, step: float, price: float, tries: int = STEP_TRIES) -> Sized:
        """Rounded with the step that fills the file, sought from this one on."""
        best, fine, coarse = None, 0.0, math.inf  # the coarsest step that is too fine, and the finest that is not
        for _ in range(tries):
            step = above(min(max(step, FINEST), COARSEST))
            made = self._coded(step, self._rounding.to(step, price))
            n_bytes = made.n_bytes
            if best is None or self._fill(made) > self._fill(best):
                best = made
            if CLOSE * self._size <= n_bytes <= self._size:
                break
            if n_bytes > self._size:
                fine = max(fine, step)
            else:
                coarse = min(coarse, step)
            # A bit more of each coordinate halves the step.
            bits = 8 * (0.995 * self._size - n_bytes)
            step = step * 2.0 ** (-bits / self._one.control.size)
            # Not evenly where coordinates repeat: the step may be known to be too fine, or too coarse.
            if 0 < fine < coarse < math.inf and not fine < above(step) < coarse:
                step = math.sqrt(fine * coarse)
            step = min(max(step, self.ideal / MOST_FINER, FINEST), COARSEST)
            if coarse < NARROW * fine or above(step) == made.mesh.step:
                break
        assert best is not None
        return best

    def polished(self, rounded: Sized, price: float, steps: int, most_error: float) -> Sized:
        """The best of this step and the next coarser ones, polished if that pays. As it is if its error is larger."""
        step, grid = rounded.mesh.step, rounded.mesh.positions.astype(np.int64)
        found = [rounded._replace(error=self._error(step, grid, self._target))]
        if found[0].error > most_error:
            return found[0]
        if steps:
            tried = [(self._error(step, grid, self._few), step, grid)]
            for _ in range(steps):
                step = above(step * NEXT_STEP)
                grid = self._rounding.to(step, price)
                tried.append((self._error(step, grid, self._few), step, grid))
            _, step, grid = min(tried, key=itemgetter(0))
        if step != rounded.mesh.step:
            found.append(self._coded(step, grid)._replace(error=self._error(step, grid, self._target)))
        most = max(self._size, rounded.n_bytes)
        # Polishing changes the bytes by a few thousandths; a little coarser they fit again.
        for coarser in (step, above(1.01 * step)):
            start = grid if coarser == step else self._rounding.to(coarser, price)
            made = self._coded(coarser, polished(self._one.basis, self._target, start, coarser, price))
            if made.n_bytes <= most:
                error = self._error(coarser, made.mesh.positions.astype(np.int64), self._target)
                found.append(made._replace(error=error))
                break
        return min((made for made in found if made.n_bytes <= most), key=lambda made: made.error)

    def _coded(self, step: float, grid: I64) -> Sized:
        control = replace(self._blank, step=step, positions=grid.astype(np.int32))
        coding = self._sizes.of(control)
        return Sized(control, coding.n_bytes, coding.repeats, math.nan)

    def _error(self, step: float, grid: I64, target: Target) -> float:
        control = np.asarray(step * grid, dtype=np.float64)
        return float(mean_errors(self._one.basis, target, control).sum())

    def _fill(self, made: Sized) -> int:
        """More is better: the bytes of what fits, and else how few they are."""
        n_bytes = made.n_bytes
        return n_bytes if n_bytes <= self._size else -n_bytes
