"""The error of a file, as its encoder measured it: default meshes are as fine as it asks for."""

from __future__ import annotations

from typing import NamedTuple

from ..format import Container

MOST_TOLERANCE = 0.01  # ADR 040: of the diagonal, whatever a file says of its error


class Errors(NamedTuple):
    """Measured errors of the file, in normalised units; mean and p99."""

    mean: float
    p99: float

    def tolerance(self, share: float, diagonal: float) -> float:
        """That share of the mean error, for the default mesh of a shape with this diagonal; normalised units."""
        return min(share * self.mean, MOST_TOLERANCE * diagonal)


def measured_errors(container: Container) -> Errors | None:
    """None where the file has none; zeros stand for none, too."""
    mean, p99 = container.metadata.mean_error, container.metadata.p99_error
    return Errors(mean / container.scale, p99 / container.scale) if mean and p99 else None
