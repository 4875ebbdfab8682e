"""Presets, and what a user may change in them."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from ..arguments import whole_in
from ..errors import OptionError
from ..format.constants import MAX_DHFS, MAX_FILE_SIZE, MAX_WIDTH
from ..mesh.lengths import parse_size
from .dhf.settings import BEST, DEFAULT, FAST, DhfSettings
from .paper.settings import PAPER, PaperSettings

Preset = Literal["fast", "default", "best", "paper"]
Settings = DhfSettings | PaperSettings

LEAST_SIZE = 400  # bytes; below this the header is most of the file
LEAST_WIDTH = 4

# Evidence for these constants: ADR 022.
PRESETS: dict[str, Settings] = {"paper": PAPER, "fast": FAST, "default": DEFAULT, "best": BEST}


def settings_for(
    preset: str,
    axes: int | None = None,
    width: int | None = None,
    target_size: int | str | None = None,
    steps: int | None = None,
) -> Settings:
    """Return a preset's settings, with the number of axes, the width or the file's size, and the steps changed where
    given.

    Raises OptionError for an unknown preset, a value out of range, or a width and a size together.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise OptionError(f"preset is {preset!r}; there are {', '.join(PRESETS)}")
    settings = PRESETS[preset]
    if axes is not None:
        settings = replace(settings, max_axes=whole_in(axes, "axes", 1, MAX_DHFS))
    if steps is not None:
        if not isinstance(settings, PaperSettings):
            raise OptionError(f"preset {preset!r} takes no number of steps; they go with `paper`")
        settings = replace(settings, steps=whole_in(steps, "steps", 1))
    if width is not None and target_size is not None:
        raise OptionError("width and target size are both given; the size decides the width, so give one of them")
    if width is not None:
        width = whole_in(width, "width", LEAST_WIDTH, MAX_WIDTH)
        if isinstance(settings, DhfSettings):
            return replace(settings, width=width, target_size=None)
        return replace(settings, width=width)
    if target_size is not None:
        if not isinstance(settings, DhfSettings):
            raise OptionError(f"preset {preset!r} takes no target size; give a width")
        size = parse_size(target_size)
        if not LEAST_SIZE <= size <= MAX_FILE_SIZE:
            raise OptionError(f"target size is {size} bytes; {LEAST_SIZE} to {MAX_FILE_SIZE} are allowed")
        return replace(settings, width=None, target_size=size)
    return settings
