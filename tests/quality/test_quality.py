"""The mean errors of whole encodes do not rise: trials of axes, fits and rounding together, on two small meshes.

A change that is meant to change them brings new figures; `pytest -m quality` says what it measured where they are off.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from places import ROOT
from quietly import encode_quietly

from cndhf_codec.encoder import settings
from cndhf_codec.encoder.dhf.settings import DEFAULT

pytestmark = [pytest.mark.slow, pytest.mark.quality, pytest.mark.encode]

# Mean error (CD), thousandths of the normalised frame, of files of at most 2 KiB: seeds 0 and 1.
FIGURES = {
    "bracket": (0.0, 0.0),
    "creature": (0.0, 0.0),
}
MOST_RISE = 1.06  # of the two seeds together; what reorders sums changes single results by 4 to 8 %
SIZE = 2048
# Every stage of `default`, with fewer steps.
SHORT = replace(
    DEFAULT,
    max_axes=3,
    steps=100,
    trial_steps=150,
    joint_steps=2000,
    samples=100_000,
    clear_cells=32,
    rounds=3,
    round_steps=200,
)


@pytest.fixture(scope="module")
def measured() -> dict[str, list[float]]:
    patch = pytest.MonkeyPatch()
    patch.setitem(settings.PRESETS, "default", SHORT)
    out: dict[str, list[float]] = {name: [] for name in FIGURES}
    for name, seed in product(FIGURES, (0, 1)):
        model, report = encode_quietly(ROOT / "examples" / f"{name}.ply", target_size=SIZE, seed=seed)
        assert 0.95 * SIZE <= len(model.dumps()) <= SIZE
        out[name].append(1000 * report.normalised.mean)
    patch.undo()
    return out


@pytest.mark.parametrize("name", FIGURES)
def test_the_mean_error_does_not_rise(measured, name):
    assert sum(measured[name]) <= MOST_RISE * sum(FIGURES[name]), measured[name]


@pytest.mark.parametrize("name", FIGURES)
def test_the_stored_figures_are_those_of_this_code(measured, name):
    # Figures that are far too high would guard nothing.
    assert sum(measured[name]) >= sum(FIGURES[name]) / MOST_RISE**2, measured[name]
