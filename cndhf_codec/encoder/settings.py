"""What a preset means: one frozen dataclass, and the four presets."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import OptionError
from ..format.constants import MAX_DHFS, MAX_WIDTH


@dataclass(frozen=True)
class Settings:
    """Everything that decides an encode, apart from the mesh and the seed. Lengths are normalised units."""

    # Axes: greedy until `coverage` of the effective area is seen, or `max_axes` are taken.
    coverage: float
    max_axes: int | None
    rarity: str  # "printed" or "inverse", see axes.effective_area

    # Network: 2 inputs, 1 + hidden_layers sine layers of `width`, 2 outputs.
    width: int
    hidden_layers: int
    omega: int

    # Height targets: pixels along the longer side of the domain box.
    target_resolution: int

    # Fit.
    optimiser: str  # "soap" or "adam"
    steps: int
    learning_rate: float
    batch: int  # points a step
    margin: float  # C: outside the silhouette the far height shall be this much below the near one
    laplacian: float  # weight of the loss on the Laplacians of the height images; 0: none, and no tiles

    # Quantisation: the fit's loss may grow by this share.
    quantisation_loss: float

    # Verification: marching-cubes resolution at which the written file is measured.
    verify_resolution: int


_DEFAULT = Settings(
    coverage=0.999,
    max_axes=3,
    rarity="printed",
    width=30,
    hidden_layers=5,
    omega=30,
    target_resolution=1024,
    optimiser="soap",
    steps=3000,
    learning_rate=3e-3,
    batch=4096,
    margin=0.01,
    laplacian=0.0,
    quantisation_loss=0.01,
    verify_resolution=256,
)

PRESETS: dict[str, Settings] = {
    # The method of CN-DHF as printed. The paper states neither image size, learning rate nor step count:
    # those are ours, and so is the number of steps, which is what a laptop's processor can bear.
    "paper": replace(
        _DEFAULT,
        max_axes=None,
        target_resolution=512,
        optimiser="adam",
        steps=5000,
        learning_rate=1e-3,
        margin=0.1,
        laplacian=10.0,
    ),
    "fast": replace(_DEFAULT, max_axes=2, width=24, target_resolution=512, steps=700, batch=2048),
    "default": _DEFAULT,
    "best": replace(_DEFAULT, max_axes=4, width=40, steps=10000),
}


def settings_for(preset: str, axes: int | None = None, width: int | None = None) -> Settings:
    """Settings of a preset, with the number of axes and the width changed where given.

    Raises OptionError for an unknown preset or a value out of range.
    """
    if preset not in PRESETS:
        raise OptionError(f"preset is {preset!r}; there are {', '.join(PRESETS)}")
    settings = PRESETS[preset]
    if axes is not None:
        if not 1 <= axes <= MAX_DHFS:
            raise OptionError(f"axes is {axes}; 1 to {MAX_DHFS} are allowed")
        settings = replace(settings, max_axes=axes)
    if width is not None:
        if not 4 <= width <= MAX_WIDTH:
            raise OptionError(f"width is {width}; 4 to {MAX_WIDTH} are allowed")
        settings = replace(settings, width=width)
    return settings
