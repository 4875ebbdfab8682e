"""Encode from end to end: mesh -> solid -> the preset's method -> verified bytes."""

from __future__ import annotations

import math
import os
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import __version__
from ..arguments import positive, whole_in
from ..arrays import F64, I64
from ..decoder.model import Model
from ..decoder.parallel import processors
from ..decoder.pieces import without_specks
from ..decoder.reading import loads
from ..decoder.results import TriangleMesh
from ..errors import CndhfWarning, EncodeError, MeshError, OptionError, SurfaceError, require
from ..format import Container, Metadata
from ..format.constants import CODEC_RANS, CODEC_ZSTD, CRC_SIZE, HEADER_SIZE, TABLE_ENTRY_SIZE
from ..format.writer import pack_metadata
from ..mesh.bodies import bodies_of_solid, bodies_of_surface
from ..mesh.distances import surface_distances
from ..mesh.lengths import Length, parse_length
from ..mesh.normalise import Normalisation
from ..mesh.prepare import AsGiven, Prepared, as_given, prepare, solid_or_error
from .deadline import Deadline
from .progress import OnStep, Progress, silent
from .report import Report, unseen
from .settings import DhfSettings, PaperSettings, Preset, Representation, Settings, SurfaceSettings, settings_for
from .size_search import ErrorLimits, smallest_file

VERIFY_SHARE = 0.1  # of a time limit
VERIFY_ERROR = "0.1%"  # most distance of the measured mesh from the limit surface, which few places come near to
LARGEST_SEED = 2**32 - 1


def encode(
    source: Any,
    *,
    preset: Preset = "default",
    representation: Representation = "dhf",
    axes: int | None = None,
    width: int | None = None,
    target_size: int | str | None = None,
    target_error: float | str | None = None,
    target_max: float | str | None = None,
    unit: str | None = None,
    thicken: float | str | None = None,
    steps: int | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    threads: int | None = None,
    source_name: bool = False,
    progress: Progress = silent,
) -> Model:
    """Encode a mesh.

    Parameters
    ----------
    source : path, binary stream, trimesh.Trimesh, trimesh.Scene or (vertices, faces)
        A file is OBJ, PLY, STL, OFF, GLB, glTF or 3MF, compressed with gzip, bzip2, xz or zstd or not. Vertices are
        (N, 3) coordinates, faces (M, 3) vertex numbers.
    preset : {"default", "fast", "best", "paper"}
        How much work to spend; "paper" is the published method, for comparison.
    representation : {"dhf", "surface"}
        "dhf": a solid as double height fields. "surface": the surface as it is given, open or closed, with its inner
        parts, as a subdivision surface.
    axes : int, optional
        The most double height fields to use. By default the preset's.
    width : int, optional
        Neurons per layer of every network. By default it follows from the file's size.
    target_size : int or str, optional
        The most bytes of the file, as a number or such as "4KiB". By default the preset's.
    target_error : float or str, optional
        The most mean error: a number in input units, "0.2%" of the bounding box's diagonal, or "0.5mm" where `unit` is
        given. Makes the smallest file found that keeps to it, by several encodes. Single points are ten to a hundred
        times as far off.
    target_max : float or str, optional
        The most maximum error, of 200,000 points on each surface, measured on the decoded file; as `target_error`, and
        may go with it.
    unit : {"mm", "cm", "m", "in"}, optional
        The input's unit, for `target_error` and `thicken`.
    thicken : float or str, optional
        Thickness of a wall that open sheets get, which have no inside otherwise; a length as in `target_error`.
    steps : int, optional
        Of the fit of each field, with preset "paper" only: 5,000 by default, a million in the paper.
    time_limit : float, optional
        Seconds. The fit is cut short to keep to it, and bytes then depend on the machine's speed.
    seed : int
        Equal seeds give equal bytes on machines of one kind. 0 to 2^32 - 1.
    threads : int, optional
        How many to use, all by default. The result does not depend on it.
    source_name : bool
        Write the source's file name into the file.
    progress : callable
        Called as the work goes on; see `encoder.progress.Progress`.

    Returns
    -------
    Model
        The decoded file; `model.save("out.cndhf")` writes it. `model.report` is a `Report` of what was done.

    Warns
    -----
    CndhfWarning
        For each line of `model.report.warnings`: what had to be assumed, and what differs from the input.

    Raises
    ------
    InputError
        The file cannot be opened.
    MeshError
        The mesh is damaged, or does not bound a solid.
    OptionError
        An argument is of a wrong type or out of range.
    EncodeError
        No file was reached that keeps to what was asked for.
    MissingExtraError
        The `encode` extra is not installed.

    Examples
    --------
    >>> import cndhf_codec, trimesh
    >>> model = cndhf_codec.encode(trimesh.creation.icosphere(4), preset="fast", target_size="1KiB")
    >>> len(model.dumps()) <= 1024, model.report.warnings
    (True, [])
    >>> model.contains([[0, 0, 0.9], [0, 0, 1.1]])
    array([ True, False])
    """
    settings = settings_for(preset, axes, width, target_size, steps, representation)
    limits = ErrorLimits(
        None if target_error is None else parse_length(target_error, unit, "target error"),
        None if target_max is None else parse_length(target_max, unit, "target max"),
    )
    if limits.given and (target_size is not None or width is not None or isinstance(settings, PaperSettings)):
        raise OptionError("target error decides the size: it goes with no target size, no width and not with `paper`")
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    seconds = math.inf if time_limit is None else positive(time_limit, "time limit", "seconds")
    threads = processors() if threads is None else whole_in(threads, "threads", 1)
    seed = check_seed(seed)
    # Fail before any work is done where a library is missing or a name cannot be stored.
    for library in ("numba", "scipy", "embreex", "igl", "trimesh", "threadpoolctl"):
        require(library, "encode")
    named = Path(source).name if source_name and isinstance(source, (str, os.PathLike)) else None
    # Zeros stand for the errors, which are measured last: the size of the file does not depend on them.
    metadata = Metadata(f"cndhf-codec {__version__}", 0.0, 0.0, 0.0, named)
    pack_metadata(metadata)
    make = _Surfaces() if isinstance(settings, SurfaceSettings) else _HeightFields()

    deadline = Deadline(seconds)
    report = Report()
    clock = _Clock(report, progress)
    clock("read", 1)
    source_mesh = make.prepared(source, wall, report, seed)
    run = _Run(make, source_mesh, metadata, seed, threads, report, clock)

    if not limits.given:
        model = run.attempt(settings, deadline)
    else:

        def attempt_size(size: int, more: int) -> tuple[Model, float]:
            assert not isinstance(settings, PaperSettings)
            made = run.attempt(replace(settings, target_size=size), deadline.part(1 / (more + 1)))
            return made, limits.excess(made.report.distances, report.diagonal)

        model = smallest_file(attempt_size, limits.text(report.diagonal))
    if seconds < math.inf and model.report.poor:
        raise EncodeError(
            f"within the time limit of {seconds:g} s only a poor fit was reached ({model.report.poor[0]}); allow more "
            "time, or use a smaller size"
        )
    for line in model.report.warnings:
        warnings.warn(line, CndhfWarning, stacklevel=2)
    return model


def check_seed(seed: object) -> int:
    return whole_in(seed, "seed", 0, LARGEST_SEED)


@dataclass(frozen=True, eq=False)
class _Source:
    """What is encoded. prepared: by `mesh.prepare`. reference: vertices and faces that the error is measured against,
    in the normalised frame. norm: that frame."""

    name: str
    prepared: AsGiven
    reference: tuple[F64, I64]
    norm: Normalisation


class _Made(NamedTuple):
    """A file without its errors, and what the report says of it."""

    container: Container
    covered: float
    visible: float
    unknown: float


class _HeightFields:
    """Solids as double height fields. Torch and numba, which take seconds to load, are loaded before the clock runs."""

    def __init__(self) -> None:
        require("torch", "encode")
        from .dhf.encode import encode_dhf
        from .paper.encode import encode_paper

        self._dhf, self._paper = encode_dhf, encode_paper

    def prepared(self, source: Any, wall: Length | None, report: Report, seed: int) -> _Source:
        made = prepare(source, wall)
        solid = solid_or_error(made)
        _report_input(report, made)
        report.bodies = bodies_of_solid(solid, seed).scaled(made.norm.scale)
        return _Source(made.given.name, made, made.reference, made.norm)

    def encode(self, source: _Source, settings: Settings, metadata: Metadata, run: _Run, deadline: Deadline) -> _Made:
        assert isinstance(source.prepared, Prepared)
        solid = source.prepared.solid
        if isinstance(settings, DhfSettings):
            codec = CODEC_RANS
            metadata_bytes = len(pack_metadata(metadata)) + TABLE_ENTRY_SIZE
            made = self._dhf(solid, settings, metadata_bytes, run.seed, run.threads, run.clock, deadline)
        else:
            assert isinstance(settings, PaperSettings)
            codec = CODEC_ZSTD
            made = self._paper(solid, settings, run.seed, run.threads, run.clock, deadline)
        if not made.records:
            raise MeshError(unseen(source.name))
        container = Container(source.norm.centre, source.norm.scale, tuple(made.records), metadata, codec)
        return _Made(container, made.covered, made.visible, made.unknown)


class _Surfaces:
    """Surfaces as they are given."""

    def __init__(self) -> None:
        from .surface.encode import encode_surface

        self._surface = encode_surface

    def prepared(self, source: Any, wall: Length | None, report: Report, seed: int) -> _Source:
        made: AsGiven
        if wall is None:
            made = as_given(source)
        else:
            made = prepare(source, wall)
            solid_or_error(made)
        _report_input(report, made)
        report.bodies = bodies_of_solid(made.solid, seed).scaled(made.norm.scale)
        return _Source(made.given.name, made, made.reference, made.norm)

    def encode(self, source: _Source, settings: Settings, metadata: Metadata, run: _Run, deadline: Deadline) -> _Made:
        assert isinstance(settings, SurfaceSettings)
        other = HEADER_SIZE + CRC_SIZE + 2 * TABLE_ENTRY_SIZE + len(pack_metadata(metadata))
        solid = source.prepared.solid
        mesh = self._surface(solid.vertices, solid.faces, settings, other, run.seed, run.clock, deadline)
        container = Container(source.norm.centre, source.norm.scale, metadata=metadata, surface=mesh)
        return _Made(container, 1.0, 1.0, 0.0)


def _report_input(report: Report, made: AsGiven) -> None:
    report.faces, report.dropped_faces = len(made.given.faces), made.given.dropped
    report.flipped, report.assumptions, report.diagonal = made.flipped, made.assumptions, made.diagonal
    report.lost = list(made.given.lost)


class _Run:
    """One mesh, encoded once or several times."""

    def __init__(
        self,
        make: _HeightFields | _Surfaces,
        source: _Source,
        metadata: Metadata,
        seed: int,
        threads: int,
        report: Report,
        clock: _Clock,
    ) -> None:
        self._make, self._source, self._metadata, self._report = make, source, metadata, report
        self.seed, self.threads, self.clock = seed, threads, clock

    def attempt(self, settings: Settings, deadline: Deadline) -> Model:
        """Encode with these settings. The model's report is that of this attempt."""
        from threadpoolctl import threadpool_limits

        source, norm = self._source, self._source.norm
        # One BLAS thread: the fits bring their own threads, and no sum may depend on how many there are.
        with threadpool_limits(1, user_api="blas"):
            made = self._make.encode(source, settings, self._metadata, self, deadline.part(1 - VERIFY_SHARE))

        self.clock("verify", 1)
        # Measure what a user would decode from the bytes on disk.
        try:
            decoded = loads(Model(made.container).dumps())
            if isinstance(settings, SurfaceSettings):
                surface = decoded.to_mesh(max_error=VERIFY_ERROR)
            else:
                surface = decoded.to_mesh(settings.verify_resolution if isinstance(settings, DhfSettings) else None)
        except SurfaceError as exc:
            raise EncodeError(
                f"{source.name}: the fit was too coarse to hold a solid; use a larger size or width, a slower preset, "
                "or more time"
            ) from exc
        made_surface = TriangleMesh(norm.apply(surface.vertices), np.asarray(surface.faces, dtype=np.int64))
        measured = surface_distances(*source.reference, *made_surface, self.seed)
        kept = made_surface
        if not isinstance(settings, SurfaceSettings):
            # What is decoded by default has no specks. Which pieces are specks, the error with them says.
            kept = without_specks(made_surface, measured.p99)
        if kept is not made_surface:
            measured = surface_distances(*source.reference, *kept, self.seed)
        self.clock.close()
        distances = measured.scaled(norm.scale)
        metadata = replace(
            self._metadata,
            mean_error=_significant(distances.mean),
            p99_error=_significant(distances.p99),
            max_error=_significant(distances.maximum),
        )
        model = Model(replace(made.container, metadata=metadata))
        model.report = replace(
            self._report,
            covered=made.covered,
            visible=made.visible,
            unknown=made.unknown,
            normalised=measured,
            distances=distances,
            decoded=replace(
                bodies_of_surface(*kept).scaled(norm.scale),
                closed=bool(surface.is_watertight),
            ),
        )
        return model


class _Clock:
    """Announce the stages of an encode and time them. A stage ends where the next begins."""

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
    """Round to four significant digits, so that sums of floats in another order give the same bytes."""
    return float(f"{value:.3e}")
