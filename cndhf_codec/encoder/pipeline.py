"""Encode from end to end: mesh -> solid -> the preset's method -> verified bytes."""

from __future__ import annotations

import math
import os
import warnings
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import RLock
from typing import Any, NamedTuple

import numpy as np

from .. import __version__
from ..arguments import positive, whole_in
from ..arrays import F64, I64
from ..decoder.model import Model
from ..decoder.parallel import processors
from ..decoder.pieces import without_specks
from ..decoder.results import TriangleMesh
from ..errors import CndhfWarning, EncodeError, MeshError, OptionError, SurfaceError, require_all
from ..format import Container, Metadata
from ..format.bfloat16 import above
from ..format.constants import CODEC_RANS, CODEC_ZSTD
from ..format.writer import other_bytes, pack_metadata, written
from ..mesh.bodies import Bodies, bodies_of_solid, bodies_of_surface
from ..mesh.distances import point_distances, surface_distances
from ..mesh.lengths import Length, parse_length
from ..mesh.prepare import AsGiven, Prepared, as_given, as_solid, solid_or_error
from ..mesh.solid import Solid
from ..mesh.unite import united
from .compiling import Compiling, told
from .deadline import Deadline
from .dhf.axes.costs import AxisCosts
from .progress import OnStep, Progress, silent
from .report import Other, Report, unseen
from .settings import DhfSettings, PaperSettings, Plan, Preset, Representation, Settings, SurfaceSettings, plan_for
from .size_search import ErrorLimits, smallest_file
from .thread_pool import ThreadPool

VERIFY_SHARE = 0.1  # of a time limit
# Evidence for these constants: ADR 037.
# Height fields, which answer queries without a mesh, are kept where they have at most so much of a surface's error.
AS_GOOD = 1.05
WORTH_IT = 0.95  # they are fitted where they promise at most so much of it
TRIAL_GAIN = 0.55  # error of the whole fit over that of the trial, at the trial's size; it falls as 1 / size
MOST_TRIED = 4096  # bytes; networks of larger files take minutes for a trial, and lose there
LARGEST_SEED = 2**32 - 1


def encode(
    source: Any,
    *,
    preset: Preset = "default",
    representation: Representation = "auto",
    axes: int | None = None,
    width: int | None = None,
    target_size: int | str | None = None,
    target_error: float | str | None = None,
    target_max: float | str | None = None,
    unit: str | None = None,
    thicken: float | str | None = None,
    solid: bool = False,
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
    representation : {"auto", "dhf", "surface"}
        "dhf": a solid as double height fields. "surface": the surface as it is given, open or closed, with its inner
        parts, as a subdivision surface. "auto": the one with less mean error, or fewer bytes with `target_error`;
        height fields where they are within 5 %. Preset "fast" makes surfaces alone, "default" height fields only where
        a short trial says that they will win, "best" both.
    axes : int, optional
        The most double height fields to use. By default the preset's. It means "dhf".
    width : int, optional
        Neurons per layer of every network. By default it follows from the file's size. It means "dhf".
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
    solid : bool
        Unite overlapping parts first, and close holes, so that a surface has no faces inside, and measure the error
        against the united solid. Double height fields unite and close in any case.
    steps : int, optional
        Of the fit of each field, with preset "paper" only: 5,000 by default, a million in the paper.
    time_limit : float, optional
        Seconds. The fit is cut short to keep to it, and bytes then depend on the machine's speed. Compiling, on a
        machine's first encode, is not counted.
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
        The mesh is damaged, or does not bound a solid where one is asked for.
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
    plan = plan_for(preset, representation, axes, width, target_size, steps)
    limits = ErrorLimits(
        None if target_error is None else parse_length(target_error, unit, "target error"),
        None if target_max is None else parse_length(target_max, unit, "target max"),
    )
    if limits.given and (target_size is not None or width is not None or isinstance(plan.dhf, PaperSettings)):
        raise OptionError("target error decides the size: it goes with no target size, no width and not with `paper`")
    wall = None if thicken is None else parse_length(thicken, unit, "thickness")
    seconds = math.inf if time_limit is None else positive(time_limit, "time limit", "seconds")
    threads = processors() if threads is None else whole_in(threads, "threads", 1)
    seed = check_seed(seed)
    # Fail before any work is done where a library is missing or a name cannot be stored.
    libraries = ("numba", "scipy", "embreex", "igl", "trimesh", "threadpoolctl")
    require_all((*libraries, "manifold3d") if solid else libraries, "encode")
    if plan.dhf is not None:
        require_all(("torch",), "encode")
    named = Path(source).name if source_name and isinstance(source, (str, os.PathLike)) else None
    # Zeros stand for the errors, which are measured last: the size of the file does not depend on them.
    metadata = Metadata(__version__, 0.0, 0.0, 0.0, named)
    pack_metadata(metadata)

    report = Report()
    clock = _Clock(report, progress)
    # The limit is on the encode: compiling, once per machine, cannot be cut short.
    deadline = Deadline(seconds, clock.compiling.now)
    with ExitStack() as during:
        during.enter_context(told(clock.compiling))
        if plan.surface is not None:
            from .surface.threads import compiled_threads

            during.enter_context(compiled_threads(threads))
        clock("read", 1)
        given = as_given(source)
        if solid:
            clock("unite", 1)
            given, report.united = united(as_solid(given, wall), seed)
            wall = None
        run = _Run(given, wall, metadata, seed, threads, report, clock, limits)
        model = run.planned(plan, deadline)
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


class _Made(NamedTuple):
    """A file before its errors are measured, and what the report says of it. body: of a surface's section."""

    container: Container
    body: bytes | None
    covered: float
    visible: float
    unknown: float


class _HeightFields:
    """Solids as double height fields."""

    distances = staticmethod(point_distances)

    def __init__(self) -> None:
        self._prepared: Prepared | None = None

    def prepared(self, given: AsGiven, wall: Length | None) -> AsGiven:
        """Make a mesh a solid, once."""
        if self._prepared is None:
            self._prepared = as_solid(given, wall)
        solid_or_error(self._prepared)
        return self._prepared

    def encode(self, source: AsGiven, settings: Settings, metadata: Metadata, run: _Run, deadline: Deadline) -> _Made:
        if isinstance(settings, DhfSettings):
            from .dhf.encode import encode_dhf

            codec = CODEC_RANS
            other = other_bytes(source.norm.centre, metadata, settings.target_size)
            made = encode_dhf(source.solid, settings, other, run.seed, run.threads, run.clock, deadline)
        else:
            from .paper.encode import encode_paper

            assert isinstance(settings, PaperSettings)
            codec = CODEC_ZSTD
            made = encode_paper(source.solid, settings, run.seed, run.threads, run.clock, deadline)
        if not made.records:
            raise MeshError(unseen(source.given.name))
        container = Container(source.norm.centre, source.norm.scale, tuple(made.records), metadata, codec)
        return _Made(container, None, made.covered, made.visible, made.unknown)


class _Surfaces:
    """Surfaces as they are given."""

    @staticmethod
    def distances(points: F64, vertices: F64, faces: I64) -> F64:
        """As `point_distances`, with the tree that the fit has: it uses all threads."""
        from .surface.nearest import Tree

        return Tree(vertices, faces).closest(points).distances

    def prepared(self, given: AsGiven, wall: Length | None) -> AsGiven:
        if wall is None:
            return given
        made = as_solid(given, wall)
        solid_or_error(made)
        return made

    def encode(self, source: AsGiven, settings: Settings, metadata: Metadata, run: _Run, deadline: Deadline) -> _Made:
        from .surface.encode import encode_surface

        assert isinstance(settings, SurfaceSettings)
        other = other_bytes(source.norm.centre, metadata, settings.target_size)
        solid = source.solid
        made = encode_surface(solid.vertices, solid.faces, settings, other, run.seed, run.clock, deadline)
        # The default mesh is as fine as the error that a file states. Until it is measured, that of the fit is near it.
        about = above(made.error * source.norm.scale)
        metadata = replace(metadata, mean_error=about, p99_error=about)
        container = Container(source.norm.centre, source.norm.scale, metadata=metadata, surface=made.mesh)
        return _Made(container, made.body, 1.0, 1.0, 0.0)


class _Run:
    """One mesh, encoded once or several times."""

    def __init__(
        self,
        given: AsGiven,
        wall: Length | None,
        metadata: Metadata,
        seed: int,
        threads: int,
        report: Report,
        clock: _Clock,
        limits: ErrorLimits,
    ) -> None:
        self._given, self._wall, self._metadata, self._report, self._limits = given, wall, metadata, report, limits
        self.seed, self.threads, self.clock = seed, threads, clock
        self._measured: tuple[Solid, Bodies] | None = None

    def planned(self, plan: Plan, deadline: Deadline) -> Model:
        """Make what is planned, and the choice where both representations are."""
        fields = _HeightFields()
        if plan.surface is None:
            assert plan.dhf is not None
            return self._best(fields, plan.dhf, deadline)
        try:
            surface = self._best(_Surfaces(), plan.surface, deadline)
        except EncodeError as failure:
            # A few hundred bytes do not hold a surface of many parts; they may hold height fields. These take minutes:
            # a time limit leaves them out.
            if plan.dhf is None or deadline.passed() > 0:
                raise
            try:
                return self._best(fields, plan.dhf, deadline)
            except MeshError:
                raise failure from None
        if plan.dhf is None or deadline.passed() > 0:
            return surface
        assert isinstance(plan.dhf, DhfSettings)
        doubt = self._doubted(fields, plan.dhf, plan.trial, surface)
        if doubt is not None:
            surface.report.other = doubt
            return surface
        try:
            dhf = self._best(fields, plan.dhf, deadline)
        except EncodeError:
            return surface
        measure = _bytes if self._limits.given else _mean_error
        kept, left = (dhf, surface) if measure(dhf) <= AS_GOOD * measure(surface) else (surface, dhf)
        kept.report.other = Other(left.representation, _mean_error(left), len(left.dumps()), "encoded")
        return kept

    def _doubted(
        self, fields: _HeightFields, settings: DhfSettings, trial: DhfSettings | None, surface: Model
    ) -> Other | None:
        """Tell why height fields would not be better than a surface: the error that they have at least or that a short
        fit promises, or None where they may be."""
        try:
            source = fields.prepared(self._given, self._wall)
        except MeshError:
            return Other("dhf", math.inf, 0, "impossible")
        error = _mean_error(surface)
        self.clock("doubt", 1)
        with ThreadPool(self.threads) as threads:
            costs = AxisCosts(source.solid, self.seed, threads)
        if costs.visible == 0:
            return Other("dhf", math.inf, 0, "impossible")
        # Only one of the two directed distances in the mean error sees what is filled.
        least = costs.depth(costs.best(settings.max_axes)) / 2 * source.norm.scale
        if least > WORTH_IT * error:
            return Other("dhf", least, 0, "at least")
        if trial is None:
            return None
        size = len(surface.dumps())
        if size > MOST_TRIED:
            return Other("dhf", math.nan, 0, "untried")
        try:
            made = self._attempt(fields, source, trial, Deadline())
        except EncodeError:
            return None
        promised = TRIAL_GAIN * _mean_error(made) * len(made.dumps()) / size
        if promised > WORTH_IT * error:
            return Other("dhf", promised, size, "trial")
        return None

    def _best(self, maker: _HeightFields | _Surfaces, settings: Settings, deadline: Deadline) -> Model:
        """Encode with these settings, or to the smallest file that keeps to the target error."""
        source = maker.prepared(self._given, self._wall)
        if not self._limits.given:
            return self._attempt(maker, source, settings, deadline)

        def attempt_size(size: int, more: int) -> tuple[Model, float]:
            assert not isinstance(settings, PaperSettings)
            sized = replace(settings, target_size=size)
            made = self._attempt(maker, source, sized, deadline.part(1 / (more + 1)))
            assert made.report.distances is not None
            return made, self._limits.excess(made.report.distances, source.diagonal)

        return smallest_file(attempt_size, self._limits.text(source.diagonal))

    def _attempt(
        self, maker: _HeightFields | _Surfaces, source: AsGiven, settings: Settings, deadline: Deadline
    ) -> Model:
        """Encode with these settings. The model's report is that of this attempt."""
        from threadpoolctl import threadpool_limits

        norm = source.norm
        # One BLAS thread: the fits bring their own threads, and no sum may depend on how many there are.
        with threadpool_limits(1, user_api="blas"):
            made = maker.encode(source, settings, self._metadata, self, deadline.part(1 - VERIFY_SHARE))

        self.clock("verify", 1)
        # Measure what a user would decode from the bytes on disk.
        try:
            decoded = Model(written(made.container, made.body)[1])
            if isinstance(settings, SurfaceSettings):
                made_surface = decoded.surface()
            else:
                mesh = decoded.to_mesh(settings.verify_resolution if isinstance(settings, DhfSettings) else None)
                made_surface = TriangleMesh(norm.apply(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
        except SurfaceError as exc:
            raise EncodeError(
                f"{source.given.name}: the fit was too coarse to hold a solid; use a larger size or width, a slower "
                "preset, or more time"
            ) from exc
        measured = surface_distances(*source.reference, *made_surface, self.seed, measure=maker.distances)
        kept = made_surface
        if not isinstance(settings, SurfaceSettings):
            # What is decoded by default has no specks. Which pieces are specks, the error with them says.
            kept = without_specks(made_surface, measured.p99)
        if kept is not made_surface:
            measured = surface_distances(*source.reference, *kept, self.seed)
        bodies = self._bodies(source)
        self.clock.close()
        distances = measured.scaled(norm.scale)
        metadata = replace(
            self._metadata,
            mean_error=above(distances.mean),
            p99_error=above(distances.p99),
            max_error=above(distances.maximum),
        )
        model = Model(replace(made.container, metadata=metadata), body=made.body)
        model.report = replace(
            self._report,
            representation=model.representation,
            faces=len(source.given.faces),
            dropped_faces=source.given.dropped,
            flipped=source.flipped,
            assumptions=source.assumptions,
            lost=list(source.given.lost),
            diagonal=source.diagonal,
            bodies=bodies,
            covered=made.covered,
            visible=made.visible,
            unknown=made.unknown,
            normalised=measured,
            distances=distances,
            decoded=bodies_of_surface(*kept).scaled(norm.scale),
        )
        return model

    def _bodies(self, source: AsGiven) -> Bodies:
        """Parts and volume of what is encoded, measured once."""
        if self._measured is None or self._measured[0] is not source.solid:
            self._measured = source.solid, bodies_of_solid(source.solid, self.seed).scaled(source.norm.scale)
        return self._measured[1]


def _mean_error(model: Model) -> float:
    assert model.report.distances is not None
    return model.report.distances.mean


def _bytes(model: Model) -> float:
    return float(len(model.dumps()))


class _Clock:
    """Announce the stages of an encode and time them. A stage ends where the next begins; compiling interrupts it."""

    def __init__(self, report: Report, progress: Progress) -> None:
        self._report, self._progress = report, progress
        self._stage, self._done, self._total, self._start = "", 0, 1, 0.0
        self._lock = RLock()  # any thread compiles
        self.compiling = Compiling(self._compiling_changed)

    def __call__(self, stage: str, total: int) -> OnStep:
        self.close()
        self._stage, self._total, self._start = stage, total, self.compiling.now()
        self._tell(0)
        return self._tell

    def close(self) -> None:
        if self._stage:
            seconds = self._report.seconds
            seconds[self._stage] = seconds.get(self._stage, 0.0) + self.compiling.now() - self._start
            if self.compiling.seconds:
                seconds["compile"] = self.compiling.seconds
            self._tell(self._total)
            self._stage = ""

    def _tell(self, done: int, loss: float = math.nan) -> None:
        with self._lock:
            self._done = done
            self._progress(self._stage, done, self._total, loss)

    def _compiling_changed(self, begins: bool) -> None:
        with self._lock:
            self._progress("compile", 0 if begins else 1, 1)
            if not begins and self._stage:
                self._progress(self._stage, self._done, self._total)
