"""Settings of the published method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class PaperSettings:
    """Everything that decides an encode, apart from the mesh and the seed. Lengths are in normalised units.

    The paper states neither image size nor learning rate nor number of steps. These are our choice; 5,000 steps are
    what a laptop's processor can do in acceptable time.
    """

    max_axes: int | None = None  # most axes; None: as many as see `coverage` of the effective area
    coverage: float = 0.999
    rarity: Literal["printed", "inverse"] = "printed"  # see axes.effective_area
    width: int = 30
    hidden_layers: int = 5  # sine layers after the first
    omega: int = 30
    # Pixels along the longer side of the domain box. Tiles of finer images show less of the shape, coarser images less
    # of its detail (ADR 034).
    target_resolution: int = 256
    steps: int = 5000
    learning_rate: float = 1e-3  # at width 30; see fit.RATE_WIDTH
    batch: int = 4096  # points per step
    margin: float = 0.1  # C: outside the silhouette the far height is to be this much below the near one
    # Weight of the loss on Laplacians, which are five-point sums. The paper's is 10; it does not say of which pixels
    # and of which discrete Laplacian. 1 here is 10 times the mean of four neighbours less the middle, on 405 pixels.
    laplacian: float = 1.0
    quantisation_loss: float = 0.01  # share by which rounding may raise the loss
    verify_resolution: int | None = None  # at which the written file is measured; None: as it is decoded by default


PAPER = PaperSettings()
