"""The `fast` preset, made to take about a second."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest


def make_tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    from cndhf_codec.encoder import pipeline, report, settings
    from cndhf_codec.mesh.distances import surface_distances

    small = replace(
        settings.PRESETS["fast"],
        max_axes=2,
        width=8,
        steps=150,
        batch=512,
        target_resolution=64,
        verify_resolution=32,
        target_size=None,
        samples=5_000,
        joint_steps=60,
        rounds=2,
        round_steps=20,
    )
    monkeypatch.setitem(settings.PRESETS, "fast", small)
    monkeypatch.setattr(pipeline, "surface_distances", partial(surface_distances, samples=2000))
    # Rough results are warned of, and warnings are errors here.
    monkeypatch.setattr(report, "POOR_ERROR", 1.0)
    monkeypatch.setattr(report.Report, "_changed", lambda _: [])
