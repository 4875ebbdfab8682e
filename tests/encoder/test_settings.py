"""Presets, and the options that change them."""

from __future__ import annotations

import pytest

from cndhf_codec.encoder.settings import PRESETS, settings_for
from cndhf_codec.errors import OptionError


def test_presets():
    assert list(PRESETS) == ["paper", "fast", "default", "best"]
    # What the paper prints, but for the Laplacians' weight: ADR 034.
    paper = settings_for("paper")
    assert (paper.coverage, paper.rarity, paper.omega, paper.hidden_layers) == (0.999, "printed", 30, 5)
    assert (paper.margin, paper.laplacian, paper.max_axes) == (0.1, 1, None)


def test_more_work_in_better_presets():
    for field in ("steps", "joint_steps", "trial_steps", "round_steps"):
        work = [getattr(PRESETS[p], field) for p in ("fast", "default", "best")]
        assert work == sorted(work)


def test_a_width_and_a_size_exclude_each_other():
    assert settings_for("default", target_size=2048).width is None
    assert settings_for("default", width=20).target_size is None
    with pytest.raises(OptionError, match="both"):
        settings_for("default", width=20, target_size=2048)
    with pytest.raises(OptionError, match="target size"):
        settings_for("default", target_size=10)
    with pytest.raises(OptionError, match="paper"):
        settings_for("paper", target_size=4096)


def test_options_change_only_what_they_name():
    changed = settings_for("fast", axes=5, width=11)
    assert (changed.max_axes, changed.width) == (5, 11)
    assert changed.steps == PRESETS["fast"].steps
    assert settings_for("fast") == PRESETS["fast"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("slow",), "preset is 'slow'; there are paper, fast, default, best"),
        (("fast", 0), "axes is 0"),
        (("fast", -1), "axes is -1"),
        (("fast", 65), "axes is 65; 1 to 64"),
        (("fast", None, 3), "width is 3; 4 to 128"),
        (("fast", None, 129), "width is 129"),
        (("fast", None, None, None, 100), "'fast' takes no number of steps"),
        (("paper", None, None, None, 0), "steps is 0"),
    ],
)
def test_out_of_range(arguments, message):
    with pytest.raises(OptionError, match=message):
        settings_for(*arguments)


def test_narrow_networks_take_more_steps_and_wide_ones_too_up_to_the_dearest_size():
    sizes = (400, 2048, 8192, 12_000, 16_384, 32_768, 131_072)
    steps = [settings_for("default", target_size=n).for_size().joint_steps for n in sizes]
    assert steps == [120_000, 80_000, 40_000, 58_594, 80_000, 40_000, 10_000]
    assert settings_for("default", width=9).for_size().joint_steps == 40_000


def test_a_short_time_leaves_out_what_cannot_be_cut_short():
    default = settings_for("default")
    assert default.within(float("inf")) is default
    assert default.within(150) is default
    some = default.within(100)
    assert (some.trial_steps, some.rounds, some.samples) == (0, default.rounds, default.samples)
    least = default.within(30)
    assert least.one_attempt
    for field in ("steps", "samples", "clear_cells", "rounds", "samples_per_weight", "target_resolution"):
        assert getattr(least, field) < getattr(default, field)
    assert least.joint_steps == default.joint_steps  # those the deadline cuts short
