"""What a preset means: one frozen dataclass, and the four presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..errors import OptionError
from ..format.constants import MAX_DHFS, MAX_FILE_SIZE, MAX_WIDTH

LEAST_SIZE = 400  # bytes; below this the header is most of the file
REFERENCE_SIZE = 8192  # bytes at which the presets' joint steps are taken as they are
MOST_STEPS = 3.0  # times as many are taken at smaller sizes
DEAREST_SIZE = 16384  # bytes up to which larger sizes get more steps; beyond, a step takes too long


@dataclass(frozen=True)
class Settings:
    """Everything that decides an encode, apart from the mesh and the seed. Lengths are normalised units."""

    # Method: the paper's (every DHF alone, axes by area), or ours (all together, axes by error).
    joint: bool

    # Axes. Paper: greedy until `coverage` of the effective area is seen, or `max_axes` are taken. Ours: the number
    # up to `max_axes` that trial fits find best.
    max_axes: int | None
    coverage: float
    rarity: str  # "printed" or "inverse", see axes.effective_area

    # Size: bytes of the file, from which the width follows; or the width of every network.
    target_size: int | None
    width: int | None
    hidden_layers: int  # sine layers after the first
    omega: int  # ours: of networks that are not wide, see joint.omega_for

    # Fit of each DHF alone.
    target_resolution: int  # pixels along the longer side of the domain box
    optimiser: str  # "soap" or "adam"
    steps: int
    learning_rate: float
    batch: int  # points a step
    margin: float  # C: outside the silhouette the far height shall be this much below the near one
    laplacian: float  # weight of the loss on the Laplacians of the height images; 0: none, and no tiles

    # Joint fit.
    samples: int  # points on the surface, and as many off it
    far_cells: int  # a side of the grid that tells where floaters are looked for
    trial_steps: int  # of the joint fit that compares numbers of axes
    tune_steps: int  # at 8 KiB; see `for_size`
    tune_rate: float

    # Rounding. Paper: the fit's loss may grow by `quantisation_loss`. Ours: `bits` a weight when no size is asked for.
    quantisation_loss: float
    bits: float
    rounds: int
    round_steps: int  # of the joint fit between rounds; as tune_steps
    round_rate: float

    # Verification: resolution at which the written file is measured; None: as it is decoded by default.
    verify_resolution: int | None

    def for_size(self) -> Settings:
        """With more joint steps at smaller sizes, where they take less time each, and at larger ones, where networks
        have more to learn; beyond DEAREST_SIZE as many fewer as they take longer."""
        if self.target_size is None:
            return self
        ratio = self.target_size / REFERENCE_SIZE
        if ratio < 1:
            factor = min(math.sqrt(1 / ratio), MOST_STEPS)
        else:
            factor = min(ratio, (DEAREST_SIZE / REFERENCE_SIZE) ** 2 / ratio)
        return replace(self, tune_steps=round(self.tune_steps * factor), round_steps=round(self.round_steps * factor))


_DEFAULT = Settings(
    joint=True,
    max_axes=4,
    coverage=0.999,
    rarity="printed",
    target_size=8192,
    width=None,
    hidden_layers=5,
    omega=30,
    target_resolution=512,
    optimiser="soap",
    steps=400,
    learning_rate=3e-3,
    batch=4096,
    margin=0.01,
    laplacian=0.0,
    samples=400_000,
    far_cells=64,
    trial_steps=600,
    tune_steps=40_000,
    tune_rate=1e-3,
    quantisation_loss=0.01,
    bits=6.2,
    rounds=4,
    round_steps=3500,
    round_rate=5e-4,
    verify_resolution=None,
)

PRESETS: dict[str, Settings] = {
    # The method of CN-DHF as printed. The paper states neither image size, learning rate nor step count:
    # those are ours, and so is the number of steps, which is what a laptop's processor can bear.
    "paper": replace(
        _DEFAULT,
        joint=False,
        max_axes=None,
        target_size=None,
        width=30,
        optimiser="adam",
        steps=5000,
        learning_rate=1e-3,
        margin=0.1,
        laplacian=10.0,
    ),
    "fast": replace(
        _DEFAULT,
        max_axes=2,
        target_size=4096,
        steps=150,
        trial_steps=0,
        tune_steps=1800,
        samples=200_000,
        rounds=3,
        round_steps=250,
    ),
    "default": _DEFAULT,
    "best": replace(_DEFAULT, steps=1000, trial_steps=1000, tune_steps=100_000, rounds=5, round_steps=5000),
}


def settings_for(
    preset: str, axes: int | None = None, width: int | None = None, target_size: int | None = None
) -> Settings:
    """Settings of a preset, with the number of axes, and the width or the file's size, changed where given.

    Raises OptionError for an unknown preset, a value out of range, or a width and a size together.
    """
    if preset not in PRESETS:
        raise OptionError(f"preset is {preset!r}; there are {', '.join(PRESETS)}")
    settings = PRESETS[preset]
    if axes is not None:
        if not 1 <= axes <= MAX_DHFS:
            raise OptionError(f"axes is {axes}; 1 to {MAX_DHFS} are allowed")
        settings = replace(settings, max_axes=axes)
    if width is not None and target_size is not None:
        raise OptionError("width and target size are both given; the size decides the width, so give one of them")
    if width is not None:
        if not 4 <= width <= MAX_WIDTH:
            raise OptionError(f"width is {width}; 4 to {MAX_WIDTH} are allowed")
        settings = replace(settings, width=width, target_size=None)
    if target_size is not None:
        if not settings.joint:
            raise OptionError(f"preset {preset!r} takes no target size; give a width")
        if not LEAST_SIZE <= target_size <= MAX_FILE_SIZE:
            raise OptionError(f"target size is {target_size} bytes; {LEAST_SIZE} to {MAX_FILE_SIZE} are allowed")
        settings = replace(settings, width=None, target_size=target_size)
    return settings
