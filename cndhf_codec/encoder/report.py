"""The report of an encode: what it did and had to assume."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..mesh.bodies import Bodies
from ..mesh.distances import Distances
from ..mesh.unite import United
from ..mesh.wording import counted, percent

# Evidence for these constants: ADR 014; MOST_VOLUME_CHANGE: 003.
POOR_ERROR = 0.025  # of the diagonal; a larger mean error is that of a failed fit
# A larger change of volume is worth a warning: it is that of a plate with sides off by a hundredth of its thickness.
MOST_VOLUME_CHANGE = 0.02
MOST_HIDDEN = 0.02  # a larger share of the surface that no axis sees is worth a warning: it will be filled


@dataclass(frozen=True)
class Other:
    """The representation that was not kept.

    representation: "dhf" or "surface". mean_error: in input units. bytes: of its file, 0 where there is none. how:
    "encoded" as the other; what a short "trial" promises; "at least", the error of exact height fields; "untried", for
    the file is large (mean_error NaN); "impossible", for the mesh bounds no solid (infinite).
    """

    representation: str
    mean_error: float
    bytes: int
    how: str


@dataclass
class Report:
    """What an encode did and had to assume; lengths in input units, shares of the input's surface area.

    Attributes
    ----------
    representation : str
        Of the file: "dhf" or "surface".
    other : Other or None
        The representation that was tried and not kept.
    united : United or None
        With `solid`: `before` and `after`, numbers of parts, and their `volume`.
    faces, dropped_faces : int
        Faces of the input, and those of zero area that were left out.
    flipped : float
        Share whose orientation was reversed.
    assumptions : list of str
        A line for each thing that was assumed.
    lost : list of str
        What the input holds beside its shape, and the file does not: colours, texture coordinates, textures, materials,
        skins, animations.
    visible, covered : float
        Shares that any candidate axis sees, and that the chosen axes see.
    unknown : float
        Share of the rays that meet a face from behind, through a hole.
    distances, normalised : Distances or None
        Between the input (its walls where it was thickened, its solid where parts were united) and the decoded file; in
        input units, and in the normalised frame.
    diagonal : float
        Of the input's bounding box.
    bodies, decoded : Bodies or None
        Parts and volume of the input and of the decoded file.
    seconds : dict
        Of each stage, and "compile" where code was compiled, which the stages leave out.
    """

    representation: str = ""
    other: Other | None = None
    united: United | None = None
    faces: int = 0
    dropped_faces: int = 0
    flipped: float = 0.0
    assumptions: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    visible: float = 0.0
    covered: float = 0.0
    unknown: float = 0.0
    distances: Distances | None = None
    normalised: Distances | None = None
    diagonal: float = 0.0
    bodies: Bodies | None = None
    decoded: Bodies | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """A line for each thing that a user should know before trusting the result."""
        return [*self.assumptions, *hidden_warning(self.visible), *self.poor, *self._changed(), *self._sheet()]

    @property
    def poor(self) -> list[str]:
        """A line where the fit has failed."""
        # What is hidden comes back filled, which has its own warning. It may be a quarter of the diagonal away, and
        # counts in one of the two directions.
        allowed = POOR_ERROR + (1 - self.visible) / 8
        if self.distances is None or self.distances.mean <= allowed * self.diagonal:
            return []
        share = 100 * self.distances.mean / self.diagonal
        return [f"the result is far from the input, {share:.1f} % of its diagonal on average; try another --seed"]

    def _sheet(self) -> list[str]:
        if self.decoded is None or self.decoded.closed:
            return []
        return [
            "the surface is open: the file holds a sheet, of which nothing is inside; --thicken would give it a wall, "
            "--representation dhf close holes"
        ]

    def _changed(self) -> list[str]:
        """Warn of changed numbers of parts and specks, and of a changed volume."""
        if self.bodies is None or self.decoded is None:
            return []
        given, made, out = self.bodies, self.decoded, []
        # The parts of an open surface are guessed: any of its faces may have cracks between them.
        if made.parts != given.parts and given.closed:
            what = "some are lost or have grown together" if made.parts < given.parts else "some have come apart"
            out.append(
                f"the input has {counted(given.parts)}, the result {counted(made.parts)}: {what}; try a larger size"
            )
        if made.minor > given.minor:
            out.append(f"the result has {counted(made.minor - given.minor, 'speck')} that the input has not")
        change = made.volume / given.volume - 1 if given.volume > 0 and made.closed else 0.0
        if abs(change) > MOST_VOLUME_CHANGE + given.noise:
            out.append(
                f"the volume of the result is {made.volume:.4g}, that of the input {given.volume:.4g} "
                f"({100 * change:+.1f} %)"
            )
        return out


def hidden_warning(visible: float) -> list[str]:
    """Warn where no axis sees more than MOST_HIDDEN of the surface."""
    if 1 - visible <= MOST_HIDDEN:
        return []
    return [
        f"{percent(1 - visible)} of the surface is hidden from every axis (cavities, inner parts) and comes back filled"
    ]


def unseen(name: str) -> str:
    return f"{name}: no axis sees any of its surface; it does not bound a solid"
