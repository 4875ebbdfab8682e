"""How much a file may make the decoder do, beyond the counts that the format itself limits."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import OptionError, SurfaceError
from ..format import Container

LEAST_RESOLUTION = 8


@dataclass(frozen=True)
class Limits:
    """Bounds of surfaces and grids; raise them for files that you trust, lower them where strangers send files.

    resolution: cells along the longest side of the solid.
    tables: double height fields times resolution squared. Their height tables take up to 256 bytes of memory for each.
    work: parameters times resolution squared. Up to 16 multiplications for each.
    vertices: of a surface, and of each solid that is intersected. Up to 250 bytes of memory for each, 2 KiB for those
        of an intersection; a file of noise has a vertex in every fourth cell.
    nodes: of an occupancy grid. 2 bytes of memory for each.

    Up to a resolution of 256 the defaults refuse no valid file.
    """

    resolution: int = 2048
    tables: int = 2**24
    work: int = 2**37
    vertices: int = 2**25
    nodes: int = 2**30

    def check(self, container: Container, resolution: int) -> None:
        """Raise OptionError for a resolution out of range, SurfaceError for a file that asks for too much at it."""
        if not LEAST_RESOLUTION <= resolution <= self.resolution:
            raise OptionError(f"resolution is {resolution}; {LEAST_RESOLUTION} to {self.resolution} are allowed")
        self.count("tables", len(container.dhfs) * resolution**2)
        self.count("work", sum(d.parameters for d in container.dhfs) * resolution**2)

    def count(self, name: str, value: int) -> None:
        """Raise SurfaceError when a count is above the limit of this name."""
        limit = getattr(self, name)
        if value > limit:
            raise SurfaceError(
                f"this file asks for too much at this resolution ({name}: {value}; {limit} are allowed): lower the "
                f"resolution, or, from Python, set model.limits = Limits({name}=...) if you trust it"
            )
