"""Widths from sizes and shares."""

from __future__ import annotations

from dataclasses import replace

import pytest
from jointly import SMALL
from quietly import encode_quietly

from cndhf_codec.encoder import settings
from cndhf_codec.encoder.dhf.widths import WIDEST_EQUAL, widths_for
from cndhf_codec.format.container import parameter_count

pytestmark = pytest.mark.encode


def test_the_widths_follow_from_the_size_and_the_shares():
    def at(size: int, *shares: float) -> list[int]:
        widths = widths_for(replace(SMALL, target_size=size), list(shares), 80)
        room = (0.98 * size - 5 - 80 - 53 * len(shares)) * 8 / SMALL.bits
        weights = [parameter_count(w, SMALL.hidden_layers) for w in widths]
        assert sum(weights) <= room
        # There is no room for another neuron: in any, or, while all are to be equally wide, in each of them.
        more = [parameter_count(w + 1, SMALL.hidden_layers) - n for w, n in zip(widths, weights, strict=True)]
        assert sum(weights) + (min(more) if max(widths) > WIDEST_EQUAL else sum(more)) > room
        return widths

    assert at(1024, 0.9, 0.1) == at(1024, 0.5, 0.5) < at(4096, 0.5, 0.5) == at(4096, 0.1, 0.9)
    equal = at(16384, 0.5, 0.5)
    assert max(equal) - min(equal) <= 1
    large, small = at(16384, 0.9, 0.1)
    assert at(16384, 1.0)[0] > large > max(equal) > small > WIDEST_EQUAL
    assert at(16384, 0.1, 0.9) == [small, large]
    # What has next to nothing to do has a silhouette, too.
    assert at(16384, 0.5, 0.5, 0.0, 0.0)[2:] == [WIDEST_EQUAL] * 2
    assert widths_for(replace(SMALL, target_size=256), [0.5, 0.5], 80) == []
    assert widths_for(replace(SMALL, target_size=None, width=4), [0.9, 0.1], 80) == [4, 4]


@pytest.mark.parametrize("size", [900, 2500])
def test_a_target_size_is_met(creature, monkeypatch, size):
    tiny = replace(
        settings.PRESETS["fast"], steps=60, batch=512, samples=10_000, joint_steps=80, rounds=2, round_steps=20
    )
    monkeypatch.setitem(settings.PRESETS, "fast", replace(tiny, target_resolution=96, verify_resolution=48))
    model, _ = encode_quietly(creature, preset="fast", representation="dhf", target_size=size)
    assert 0.95 * size <= len(model.dumps()) <= size
    assert model.report.normalised.mean < 0.3
