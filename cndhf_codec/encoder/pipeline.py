"""The encoder from end to end: mesh -> solid -> axes -> height targets -> fit -> quantise -> verify."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..decoder.model import Model, loads
from ..errors import MeshError, OptionError, require
from ..format import Container, Metadata
from .axes import choose_axes
from .heights import frame_for_axis, height_targets
from .normalise import normalisation
from .progress import Progress, silent
from .read import read_mesh
from .settings import Settings, settings_for
from .solid import Solid
from .verify import Distances, surface_distances


@dataclass
class Report:
    """What an encode did and had to assume. Shares are of the input's surface area."""

    settings: Settings
    faces: int = 0
    dropped_faces: int = 0  # of zero area
    flipped: float = 0.0  # share whose orientation was reversed
    visible: float = 0.0  # share that a double height field along some candidate axis can see
    covered: float = 0.0  # share that the chosen axes see
    unknown: float = 0.0  # share of the rays that meet a face from behind, through a hole
    distances: Distances | None = None  # input units
    normalised: Distances | None = None  # normalised frame
    diagonal: float = 0.0  # of the input's bounding box, input units
    seconds: dict[str, float] = field(default_factory=dict)


def encode(
    source: Any,
    preset: str = "default",
    *,
    axes: int | None = None,
    width: int | None = None,
    seed: int = 0,
    device: str = "auto",
    threads: int | None = None,
    source_name: bool = False,
    progress: Progress = silent,
) -> Model:
    """Encode a mesh.

    source: a path (OBJ, PLY, STL, OFF, GLB), a `trimesh.Trimesh` or `Scene`, or a (vertices, faces) pair.
    preset: "fast", "default", "best" or "paper". axes: the most DHFs to use. width: of every network.
    seed: equal seeds give equal bytes on the same kind of machine. device: "auto", "cpu" or "cuda".
    threads: how many to use, all by default; the result does not depend on it. source_name: write the
    source's file name into the file. Raises a subclass of CndhfError.
    """
    return encode_with_report(
        source,
        preset,
        axes=axes,
        width=width,
        seed=seed,
        device=device,
        threads=threads,
        source_name=source_name,
        progress=progress,
    )[0]


def encode_with_report(
    source: Any,
    preset: str = "default",
    *,
    axes: int | None = None,
    width: int | None = None,
    seed: int = 0,
    device: str = "auto",
    threads: int | None = None,
    source_name: bool = False,
    progress: Progress = silent,
) -> tuple[Model, Report]:
    """As `encode`, with a Report of what was done."""
    settings = settings_for(preset, axes, width)
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if threads < 1:
        raise OptionError(f"threads is {threads}; 1 or more are needed")
    if not 0 <= seed < 2**32:
        raise OptionError(f"seed is {seed}; 0 to 2^32 - 1 are allowed")
    require("torch", "encode")
    from .fit import choose_device, fit_all  # the only modules that need torch
    from .quantise import quantise

    torch_device = choose_device(device)
    report = Report(settings)
    clock = _Clock(report, progress)

    with clock("read", 1):
        mesh = read_mesh(source)
        norm = normalisation(mesh)
        solid = Solid(norm.apply(mesh.vertices), mesh.faces)
        report.faces, report.dropped_faces, report.flipped = len(mesh.faces), mesh.dropped, solid.flipped
    with clock("axes", 1):
        choice = choose_axes(solid, seed, threads, settings.rarity, settings.coverage, settings.max_axes)
        if choice.visible == 0:
            raise MeshError(f"{mesh.name}: no axis sees any of its surface; it does not bound a solid")
        report.visible, report.covered = choice.visible, float(choice.covered[-1])
    with clock("heights", len(choice.axes)):
        targets = []
        for k, axis in enumerate(choice.axes):
            targets.append(height_targets(solid, frame_for_axis(axis, solid.vertices), settings.target_resolution))
            clock.tick(k + 1)
        report.unknown = max(t.unknown for t in targets)
        if not any(t.hit.any() for t in targets):
            raise MeshError(f"{mesh.name}: bounds no solid (no ray meets it)")
    with clock("fit", settings.steps * len(targets)):

        def on_steps(done: int, total: int, loss: float) -> None:
            progress("fit", done, total, loss)

        fitted = fit_all(targets, settings, seed, torch_device, threads, on_steps)
    with clock("quantise", len(targets)):
        records = []
        for k, (tensors, target) in enumerate(zip(fitted, targets, strict=True)):
            records.append(quantise(tensors, target, settings, seed))
            clock.tick(k + 1)
    with clock("verify", 1):
        from .. import __version__

        named = Path(source).name if source_name and isinstance(source, (str, os.PathLike)) else None
        metadata = Metadata(encoder=f"cndhf-codec {__version__}", source=named)
        container = Container(norm.centre, norm.scale, tuple(records), metadata)
        # What is measured is what a user would decode from the bytes on disk.
        surface = loads(Model(container).dumps()).to_mesh(settings.verify_resolution)
        measured = surface_distances(solid.vertices, solid.faces, norm.apply(surface.vertices), surface.faces, seed)
        report.normalised, report.distances = measured, measured.scaled(norm.scale)
        extent = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
        report.diagonal = float((extent @ extent) ** 0.5)
        metadata = replace(
            metadata,
            mean_error=_significant(report.distances.chamfer),
            p99_error=_significant(report.distances.p99),
            max_error=_significant(report.distances.maximum),
        )
        model = Model(replace(container, metadata=metadata))
    return model, report


class _Clock:
    """Times the stages and announces them."""

    def __init__(self, report: Report, progress: Progress) -> None:
        self._report, self._progress = report, progress
        self._stage, self._total, self._start = "", 1, 0.0

    def __call__(self, stage: str, total: int) -> _Clock:
        self._stage, self._total = stage, total
        return self

    def __enter__(self) -> None:
        self._start = time.perf_counter()
        self._progress(self._stage, 0, self._total)

    def __exit__(self, kind: object, *_: object) -> None:
        self._report.seconds[self._stage] = time.perf_counter() - self._start
        if kind is None:
            self._progress(self._stage, self._total, self._total)

    def tick(self, done: int) -> None:
        self._progress(self._stage, done, self._total)


def _significant(value: float) -> float:
    """Four significant digits: an error that floats sum in another order still gives the same bytes."""
    return float(f"{value:.3e}")
