"""How much work and memory a file may make the decoder use, beyond the counts that the format itself limits."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from ..arguments import real_number, whole_number
from ..errors import OptionError, SurfaceError
from ..format import Container

MIN_RESOLUTION = 8


@dataclass(frozen=True)
class Limits:
    """Upper bounds for surfaces and grids.

    Raise them for files that you trust; lower them where strangers send files. Up to a resolution of 256 the defaults
    refuse no valid file.

    Parameters
    ----------
    resolution : int
        Cells along the longest side of the solid.
    tables : int
        Number of double height fields times resolution squared. Up to 256 bytes of memory for each, in height tables.
    work : int
        Parameters of the networks times resolution squared. Up to 16 multiplications for each.
    vertices : int
        Vertices of a mesh, and of each solid that is intersected. Up to 250 bytes of memory for each; 2 KiB for those
        of an intersection; for those of a subdivision surface 700 bytes, with normals 1,200. A file of noise has a
        vertex in every fourth cell.
    nodes : int
        Nodes of an occupancy grid. 2 bytes of memory for each.

    Raises
    ------
    OptionError
        When a limit is not a number.

    Examples
    --------
    >>> import cndhf_codec
    >>> model = cndhf_codec.load("tests/golden/encoded.cndhf", limits=cndhf_codec.Limits(resolution=32))
    >>> model.occupancy(64)
    Traceback (most recent call last):
    ...
    cndhf_codec.errors.OptionError: resolution is 64; 8 to 32 are allowed
    """

    resolution: int = 2048
    tables: int = 2**24
    work: int = 2**37
    vertices: int = 2**25
    nodes: int = 2**30

    def __post_init__(self) -> None:
        for field in fields(self):
            real_number(getattr(self, field.name), f"Limits: {field.name}")

    def check(self, container: Container, resolution: Any) -> int:
        """The resolution as an int, if it is allowed for this file.

        Raises OptionError when it is out of range, SurfaceError when the file asks for too much at it.
        """
        resolution = whole_number(resolution, "resolution")
        if not MIN_RESOLUTION <= resolution <= self.resolution:
            raise OptionError(f"resolution is {resolution}; {MIN_RESOLUTION} to {self.resolution} are allowed")
        self.count("tables", len(container.dhfs) * resolution**2)
        self.count("work", sum(d.parameters for d in container.dhfs) * resolution**2)
        return resolution

    def count(self, name: str, value: int) -> None:
        """Raise SurfaceError when a count is above the limit of this name."""
        limit = getattr(self, name)
        if value > limit:
            raise SurfaceError(
                f"this file asks for too much at this resolution ({name}: {value}; {limit} are allowed): lower the "
                f"resolution, or, from Python, set model.limits = Limits({name}=...) if you trust it"
            )
