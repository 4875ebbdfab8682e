"""Settings of double height fields that are fitted together, and the presets of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

# Evidence for these constants: ADR 011; DEFAULT, FAST, BEST: 022; TRIAL: 037.
REFERENCE_SIZE = 8192  # bytes at which the presets' joint steps hold
MOST_STEPS_FACTOR = 3.0  # smaller sizes get more steps, at most so many times as many
MOST_STEPS_SIZE = 16384  # bytes up to which larger sizes get more steps; beyond, a step takes too long
# Seconds of a time limit below which there are no trials of axes, each of which takes some seconds before its first
# step; and below which all that does not get shorter with the fit is made smaller.
ROOM_FOR_TRIALS, ROOM_FOR_ALL = 150.0, 75.0


@dataclass(frozen=True)
class DhfSettings:
    """Everything that decides an encode, apart from the mesh and the seed. Lengths are in normalised units."""

    # Axes: the number up to `max_axes` that trial fits find best.
    max_axes: int = 4

    # Size: bytes of the file, from which the widths follow; or the width of every network.
    target_size: int | None = 8192
    width: int | None = None
    hidden_layers: int = 5  # sine layers after the first
    omega: int = 30  # of networks that are not wide, see widths.omega_for

    # Single fits.
    target_resolution: int = 512  # pixels along the longer side of the domain box
    steps: int = 400
    learning_rate: float = 3e-3
    batch: int = 4096  # points per step, of joint fits too
    margin: float = 0.01  # outside the silhouette the far height is to be this much below the near one

    # Joint fit.
    samples: int = 400_000  # of the surface, and as many of space
    clear_cells: int = 64  # per side of the grid over clear space
    trial_steps: int = 600  # joint steps of the trials that compare sets of axes; 0: no trials
    joint_steps: int = 40_000  # at REFERENCE_SIZE; see `for_size`
    joint_rate: float = 1e-3

    # Rounding.
    bits: float = 6.2  # per weight, when no size is asked for
    rounds: int = 4
    round_steps: int = 3500  # joint steps between rounds, at REFERENCE_SIZE
    round_rate: float = 5e-4

    samples_per_weight: float = 4.0  # of the surface, for the Gauss-Newton matrices
    one_attempt: bool = False  # at rounding, unless the file is too large

    # Resolution at which the written file is measured; None: as it is decoded by default.
    verify_resolution: int | None = None

    def for_size(self) -> DhfSettings:
        """Adapt the joint steps to the target size. Smaller sizes get more, since each takes less time; larger ones get
        more, since networks have more to learn, but beyond MOST_STEPS_SIZE fewer again, as each takes longer."""
        if self.target_size is None:
            return self
        ratio = self.target_size / REFERENCE_SIZE
        if ratio < 1:
            factor = min(math.sqrt(1 / ratio), MOST_STEPS_FACTOR)
        else:
            factor = min(ratio, (MOST_STEPS_SIZE / REFERENCE_SIZE) ** 2 / ratio)
        return replace(self, joint_steps=round(self.joint_steps * factor), round_steps=round(self.round_steps * factor))

    def within(self, seconds: float) -> DhfSettings:
        """Leave out or make smaller what takes its time however short the fit is, where a time limit has no room."""
        if seconds >= ROOM_FOR_TRIALS:
            return self
        short = replace(self, trial_steps=0)
        if seconds >= ROOM_FOR_ALL:
            return short
        return replace(
            short,
            steps=min(self.steps, 150),
            target_resolution=min(self.target_resolution, 256),
            samples=min(self.samples, 100_000),
            clear_cells=min(self.clear_cells, 32),
            rounds=min(self.rounds, 2),
            samples_per_weight=1.5,
            one_attempt=True,
        )


DEFAULT = DhfSettings()
FAST = replace(
    DEFAULT,
    max_axes=2,
    target_size=4096,
    steps=150,
    trial_steps=0,
    joint_steps=1800,
    samples=200_000,
    rounds=3,
    round_steps=250,
)
BEST = replace(DEFAULT, steps=1000, trial_steps=1000, joint_steps=100_000, rounds=5, round_steps=5000)
# Tells in some 15 seconds whether height fields may be better than a surface.
TRIAL = replace(
    FAST,
    target_size=2048,
    steps=60,
    target_resolution=256,
    joint_steps=600,
    samples=100_000,
    rounds=1,
    round_steps=60,
    verify_resolution=128,
)
