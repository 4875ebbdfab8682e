"""Presets, and what a user may change in them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from ..arguments import whole_in
from ..errors import OptionError
from ..format.constants import MAX_DHFS, MAX_FILE_SIZE, MAX_WIDTH
from ..mesh.lengths import parse_size
from .dhf.settings import BEST, DEFAULT, FAST, TRIAL, DhfSettings
from .paper.settings import PAPER, PaperSettings
from .surface import settings as surface
from .surface.settings import SurfaceSettings

Preset = Literal["fast", "default", "best", "paper"]
Representation = Literal["auto", "dhf", "surface"]
Settings = DhfSettings | PaperSettings | SurfaceSettings

LEAST_SIZE = 400  # bytes; below this the header is most of the file
LEAST_WIDTH = 4

# Evidence for these constants: ADR 022.
PRESETS: dict[str, DhfSettings | PaperSettings] = {"paper": PAPER, "fast": FAST, "default": DEFAULT, "best": BEST}
SURFACE_PRESETS = {"fast": surface.FAST, "default": surface.DEFAULT, "best": surface.BEST}
REPRESENTATIONS = ("auto", "dhf", "surface")


@dataclass(frozen=True)
class Plan:
    """What is to be made: a surface, height fields, or both, of which the better is kept.

    trial: where both are planned, settings of short fits that tell whether height fields are worth their time; None
    where they are made in any case.
    """

    surface: SurfaceSettings | None
    dhf: DhfSettings | PaperSettings | None
    trial: DhfSettings | None = None


def plan_for(
    preset: str,
    representation: str = "auto",
    axes: int | None = None,
    width: int | None = None,
    target_size: int | str | None = None,
    steps: int | None = None,
) -> Plan:
    """Plan an encode. With "auto" a number of axes, a width and the preset `paper` mean height fields.

    Raises OptionError for an unknown preset or representation, a value out of range, or options that exclude each
    other.
    """
    if representation not in REPRESENTATIONS:
        raise OptionError(f"representation is {representation!r}; there are {', '.join(REPRESENTATIONS)}")
    only_dhf = preset not in SURFACE_PRESETS or any(value is not None for value in (axes, width, steps))
    if representation == "dhf" or (representation == "auto" and only_dhf):
        return Plan(None, settings_for(preset, axes, width, target_size, steps))
    surface = _surface_settings(preset, target_size, {"axes": axes, "width": width, "steps": steps})
    if representation == "surface" or preset == "fast":
        return Plan(surface, None)
    dhf = settings_for(preset, target_size=target_size)
    assert isinstance(dhf, DhfSettings)
    return Plan(surface, dhf, TRIAL if preset == "default" else None)


def settings_for(
    preset: str,
    axes: int | None = None,
    width: int | None = None,
    target_size: int | str | None = None,
    steps: int | None = None,
) -> DhfSettings | PaperSettings:
    """Return a preset's settings of height fields, with the number of axes, the width or the file's size, and the steps
    changed where given.

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
        return replace(settings, width=None, target_size=_size(target_size))
    return settings


def _surface_settings(preset: str, target_size: int | str | None, others: dict[str, int | None]) -> SurfaceSettings:
    if preset not in PRESETS:
        raise OptionError(f"preset is {preset!r}; there are {', '.join(PRESETS)}")
    if preset not in SURFACE_PRESETS:
        raise OptionError(f"preset {preset!r} makes height fields; with representation 'surface' take another")
    for name, value in others.items():
        if value is not None:
            raise OptionError(f"{name} is given, which height fields have; leave it out with representation 'surface'")
    settings = SURFACE_PRESETS[preset]
    return settings if target_size is None else replace(settings, target_size=_size(target_size))


def _size(target_size: int | str) -> int:
    size = parse_size(target_size)
    if not LEAST_SIZE <= size <= MAX_FILE_SIZE:
        raise OptionError(f"target size is {size} bytes; {LEAST_SIZE} to {MAX_FILE_SIZE} are allowed")
    return size
