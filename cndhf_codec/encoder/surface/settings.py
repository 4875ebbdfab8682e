"""Settings of subdivision surfaces, and the presets of them."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SurfaceSettings:
    """Everything that decides an encode, apart from the mesh and the seed."""

    target_size: int = 4096  # bytes of the file
    trial_rounds: int = 2  # of closest points, for each choice of sharp edges
    rounds: int = 8  # more, for the best of them
    samples: int = 40_000  # at least, of the input's surface, and of the fitted one
    samples_per_vertex: int = 40  # of the control mesh, at least
    tries: int = 8  # of different numbers of faces, at most; more only while the file is too large
    # Further tries with so many times the faces of the best until then; the best of all is kept.
    other_counts: tuple[float, ...] = (0.94, 1.06)
    # Another number of vertices is tried where that is foretold to take this share off the error.
    least_foretold: float = 0.05
    grid_steps: int = 12  # coarser ones, that are tried where edges are sharp
    edits: int = 4  # cycles of edits of the best of them


DEFAULT = SurfaceSettings(target_size=8192)
FAST = replace(
    DEFAULT,
    target_size=4096,
    trial_rounds=1,
    rounds=4,
    samples=20_000,
    samples_per_vertex=16,
    tries=2,
    other_counts=(),
    least_foretold=0.15,
    grid_steps=6,
    edits=0,
)
BEST = replace(
    DEFAULT,
    trial_rounds=3,
    rounds=16,
    samples=80_000,
    samples_per_vertex=80,
    tries=12,
    other_counts=(0.88, 0.94, 0.97, 1.03, 1.06, 1.12),
    grid_steps=24,
    edits=8,
)
