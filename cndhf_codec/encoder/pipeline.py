"""The encoder from end to end: mesh -> solid -> the preset's method -> verified bytes."""

from __future__ import annotations

import os
import time
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..decoder.model import Model, loads
from ..decoder.parallel import processors
from ..errors import CndhfWarning, EncodeError, MeshError, OptionError, SurfaceError, require
from ..format import Container, Metadata
from ..format.constants import CODEC_RANS, CODEC_ZSTD, TABLE_ENTRY_SIZE
from ..format.writer import pack_metadata
from ..mesh.bodies import Bodies, bodies_of_solid, bodies_of_surface
from ..mesh.distances import Distances, surface_distances
from ..mesh.prepare import counted, percent, prepare, solid_or_error
from .deadline import Deadline
from .progress import OnStep, Progress, silent
from .settings import Settings, settings_for
from .size_search import parse_length, smallest_file

VERIFY_SHARE = 0.1  # of a time limit
POOR = 0.025  # a larger mean error, of the diagonal, is that of a failed fit
# A larger change of volume is worth a warning: that of a plate with sides off by a hundredth of its thickness.
VOLUME_CHANGE = 0.02
UNSEEN = 0.02  # a larger share of the surface that no axis sees is worth a warning: it will be filled


@dataclass
class Report:
    """What an encode did and had to assume. Shares are of the input's surface area."""

    settings: Settings
    faces: int = 0
    dropped_faces: int = 0  # of zero area
    flipped: float = 0.0  # share whose orientation was reversed
    assumptions: list[str] = field(default_factory=list)  # a line for each thing that was taken for granted
    visible: float = 0.0  # share that a double height field along some candidate axis can see
    covered: float = 0.0  # share that the chosen axes see
    unknown: float = 0.0  # share of the rays that meet a face from behind, through a hole
    distances: Distances | None = None  # from the input, or from its walls where it was thickened; input units
    normalised: Distances | None = None  # normalised frame
    diagonal: float = 0.0  # of the input's bounding box, input units
    bodies: Bodies | None = None  # of the input, input units
    decoded: Bodies | None = None  # of the result
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """A line for each thing that a user should know of before trusting the result."""
        return [*self.assumptions, *hidden_warning(self.visible), *self._poor(), *self._changed()]

    def _poor(self) -> list[str]:
        # What is hidden comes back filled, which is told: say a quarter of the diagonal away, in one direction of two.
        allowed = POOR + (1 - self.visible) / 8
        if self.distances is None or self.distances.chamfer <= allowed * self.diagonal:
            return []
        share = 100 * self.distances.chamfer / self.diagonal
        return [f"the result is far from the input, {share:.1f} % of its diagonal on average; try another --seed"]

    def _changed(self) -> list[str]:
        """What a person would count, and find changed."""
        if self.bodies is None or self.decoded is None:
            return []
        given, made, out = self.bodies, self.decoded, []
        # Of an open surface parts are but guessed: cracks may go between any of its faces.
        if made.parts != given.parts and given.closed:
            what = "some are lost or have grown together" if made.parts < given.parts else "some have come apart"
            out.append(
                f"the input has {counted(given.parts)}, the result {counted(made.parts)}: {what}; try a larger size"
            )
        if made.minor > given.minor:
            out.append(f"the result has {counted(made.minor - given.minor, 'speck')} that the input has not")
        change = made.volume / given.volume - 1 if given.volume > 0 else 0.0
        if abs(change) > VOLUME_CHANGE + given.noise:
            out.append(
                f"the volume of the result is {made.volume:.4g}, that of the input {given.volume:.4g} "
                f"({100 * change:+.1f} %)"
            )
        return out


def check_seed(seed: int) -> None:
    if not 0 <= seed < 2**32:
        raise OptionError(f"seed is {seed}; 0 to 2^32 - 1 are allowed")


def unseen(name: str) -> str:
    return f"{name}: no axis sees any of its surface; it does not bound a solid"


def hidden_warning(visible: float) -> list[str]:
    """A line where more of the surface is hidden than can go without saying."""
    if 1 - visible <= UNSEEN:
        return []
    return [
        f"{percent(1 - visible)} of the surface is hidden from every axis (cavities, inner parts) and comes back filled"
    ]


def encode(
    source: Any,
    preset: str = "default",
    *,
    axes: int | None = None,
    width: int | None = None,
    target_size: int | None = None,
    target_error: float | str | None = None,
    unit: str | None = None,
    thicken: float | str | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    device: str = "cpu",
    threads: int | None = None,
    source_name: bool = False,
    progress: Progress = silent,
) -> Model:
    """Encode a mesh.

    source: a path or a binary stream (OBJ, PLY, STL, OFF, GLB, glTF, 3MF), a `trimesh.Trimesh` or `Scene`, or a
    (vertices, faces) pair.
    preset: "fast", "default", "best" or "paper". axes: the most DHFs to use. width: of every network.
    target_size: bytes that the file shall not exceed (the width then follows from it).
    target_error: mean error that the file shall not exceed, in input units, or as a string "0.2%" of the bounding
    box's diagonal, or, when unit ("mm", "cm", "m" or "in") says what the input's unit is, "0.5mm": the smallest file
    found that keeps to it, by several encodes. EncodeError when none does.
    thicken: the thickness of a wall that open sheets get, which have no inside otherwise; a length as in target_error.
    time_limit: seconds; the fit is cut short to keep to it, so that bytes then depend on the machine's speed.
    seed: equal seeds give equal bytes on the same kind of machine. device: "cpu" or "cuda", which is slower.
    threads: how many to use, all by default; the result does not depend on it. source_name: write the
    source's file name into the file. A CndhfWarning tells each thing that had to be assumed. Raises a subclass of
    CndhfError.
    """
    model, report = encode_with_report(
        source,
        preset,
        axes=axes,
        width=width,
        target_size=target_size,
        target_error=target_error,
        unit=unit,
        thicken=thicken,
        time_limit=time_limit,
        seed=seed,
        device=device,
        threads=threads,
        source_name=source_name,
        progress=progress,
    )
    for line in report.warnings:
        warnings.warn(line, CndhfWarning, stacklevel=2)
    return model


def encode_with_report(
    source: Any,
    preset: str = "default",
    *,
    axes: int | None = None,
    width: int | None = None,
    target_size: int | None = None,
    target_error: float | str | None = None,
    unit: str | None = None,
    thicken: float | str | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    device: str = "cpu",
    threads: int | None = None,
    source_name: bool = False,
    progress: Progress = silent,
) -> tuple[Model, Report]:
    """As `encode`, with a Report of what was done."""
    settings = settings_for(preset, axes, width, target_size)
    goal = None if target_error is None else parse_length(target_error, unit, "target error")
    if goal is not None and (target_size is not None or width is not None or not settings.joint):
        raise OptionError("target error decides the size: it goes with no target size, no width and not with `paper`")
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    if time_limit is not None and not time_limit > 0:
        raise OptionError(f"time limit is {time_limit}; give a positive number of seconds")
    if threads is None:
        threads = processors()
    if threads < 1:
        raise OptionError(f"threads is {threads}; 1 or more are needed")
    check_seed(seed)
    # Named before any work is done: a library that is missing, and a name that cannot be stored.
    for library in ("torch", "numba", "embreex", "igl", "trimesh", "threadpoolctl"):
        require(library, "encode")
    from threadpoolctl import threadpool_limits

    from .dhf.encode import encode_joint
    from .dhf.fit.single import choose_device
    from .paper.encode import encode_paper

    torch_device = choose_device(device)
    named = Path(source).name if source_name and isinstance(source, (str, os.PathLike)) else None
    # Zeros stand for the errors, which are measured last: the size of the file does not depend on them.
    metadata = Metadata(f"cndhf-codec {__version__}", 0.0, 0.0, 0.0, named)
    metadata_bytes = len(pack_metadata(metadata)) + TABLE_ENTRY_SIZE
    report = Report(settings)
    clock = _Clock(report, progress)
    deadline = Deadline() if time_limit is None else Deadline(time_limit)

    clock("read", 1)
    prepared = prepare(source, wall)
    given, norm, solid = prepared.given, prepared.norm, solid_or_error(prepared)
    report.faces, report.dropped_faces, report.flipped = len(given.faces), given.dropped, prepared.flipped
    report.assumptions, report.diagonal = prepared.assumptions, prepared.diagonal
    report.bodies = bodies_of_solid(solid, seed).scaled(norm.scale)

    def attempt(settings: Settings, deadline: Deadline) -> tuple[Model, Report]:
        """One encode, as the settings say."""
        fit_deadline = deadline.part(1 - VERIFY_SHARE)
        # One BLAS thread: the fits bring their own threads, and no sum depends on how many there are.
        with threadpool_limits(1, user_api="blas"):
            if settings.joint:
                done = encode_joint(solid, settings, metadata_bytes, seed, torch_device, threads, clock, fit_deadline)
            else:
                done = encode_paper(solid, settings, seed, torch_device, threads, clock, fit_deadline)
        records, report.covered, report.visible, report.unknown = done
        if not records:
            raise MeshError(unseen(given.name))

        clock("verify", 1)
        container = Container(
            norm.centre, norm.scale, tuple(records), metadata, CODEC_RANS if settings.joint else CODEC_ZSTD
        )
        # What is measured is what a user would decode from the bytes on disk.
        try:
            surface = loads(Model(container).dumps()).to_mesh(settings.verify_resolution)
        except SurfaceError as exc:
            raise EncodeError(
                f"{given.name}: the fit was too coarse to hold a solid; use a larger size or width, a slower preset, "
                "or more time"
            ) from exc
        measured = surface_distances(*prepared.reference, norm.apply(surface.vertices), surface.faces, seed)
        clock.close()
        distances = measured.scaled(norm.scale)
        with_errors = replace(
            metadata,
            mean_error=_significant(distances.chamfer),
            p99_error=_significant(distances.p99),
            max_error=_significant(distances.maximum),
        )
        model = Model(replace(container, metadata=with_errors))
        made = bodies_of_surface(np.asarray(surface.vertices), np.asarray(surface.faces, dtype=np.int64))
        return model, replace(report, settings=settings, normalised=measured, distances=distances, decoded=made)

    if goal is None:
        return attempt(settings, deadline)

    def attempt_size(size: int, more: int) -> tuple[tuple[Model, Report], float]:
        result = attempt(replace(settings, target_size=size), deadline.part(1 / (more + 1)))
        distances = result[1].distances
        assert distances is not None
        return result, distances.chamfer

    return smallest_file(attempt_size, goal.in_units(report.diagonal))


class _Clock:
    """Announces the stages and times them; a stage ends where the next begins."""

    def __init__(self, report: Report, progress: Progress) -> None:
        self._report, self._progress = report, progress
        self._stage, self._total, self._start = "", 1, 0.0

    def __call__(self, stage: str, total: int) -> OnStep:
        self.close()
        self._stage, self._total, self._start = stage, total, time.perf_counter()
        self._progress(stage, 0, total)
        return lambda done, loss: self._progress(stage, done, total, loss)

    def close(self) -> None:
        if self._stage:
            seconds = self._report.seconds
            seconds[self._stage] = seconds.get(self._stage, 0.0) + time.perf_counter() - self._start
            self._progress(self._stage, self._total, self._total)
            self._stage = ""


def _significant(value: float) -> float:
    """Four significant digits: an error that floats sum in another order still gives the same bytes."""
    return float(f"{value:.3e}")
