"""Rounding to a size: the aim follows the size of the last attempt, and artifacts decide between attempts."""

from __future__ import annotations

from dataclasses import replace

import pytest
from jointly import SMALL, job_of, networks, plan_of

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.rounding import to_size
from cndhf_codec.errors import EncodeError

SIZE = 4096
ROOM = SIZE - 30 - 1 - 2 * to_size.RECORD_BYTES


class Attempts:
    """In place of the rounding: records what each attempt aims at, and gives it a size and artifacts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, sizes: list[float], artifacts: list[int]) -> None:
        self.aims: list[float] = []
        self._sizes = iter(sizes)
        counts = iter(artifacts)
        monkeypatch.setattr(to_size, "gauss_newton_matrices", lambda *a: [])
        monkeypatch.setattr(to_size, "relative_steps", lambda *a: None)
        monkeypatch.setattr(to_size, "step_codes", lambda *a: None)
        monkeypatch.setattr(to_size, "round_networks", lambda *a: None)
        monkeypatch.setattr(to_size, "records_of", lambda *a: len(self.aims))
        monkeypatch.setattr(to_size, "coded_size", lambda records: next(self._sizes))
        monkeypatch.setattr(to_size, "_bits_for", self._bits_for)
        self.loss = type("Loss", (), {"artifacts": lambda self, nets: next(counts)})()

    def _bits_for(self, nets: object, logs: object, size: float) -> float:
        self.aims.append(size)
        return 6.0

    def run(self, solid, frames, **options) -> int:
        job = job_of(solid, replace(SMALL, target_size=SIZE, **options))
        return to_size.round_to_size(job, plan_of(job, frames, [0.5, 0.5]), networks(), self.loss, Deadline())


def test_the_aim_follows_what_the_last_attempt_came_to(solid, frames, monkeypatch):
    # Too large, far too small, good.
    attempts = Attempts(monkeypatch, [1.1 * ROOM, 0.8 * ROOM, 0.99 * ROOM], [10, 10, 10, 9])
    assert attempts.run(solid, frames) == 3
    first = to_size.SIZE_AIM * ROOM
    assert attempts.aims == pytest.approx([first, first * 0.98 / 1.1, first * 0.98 / 1.1 * 0.98 / 0.8])


def test_artifacts_are_a_reason_for_another_attempt_and_the_fewest_win(solid, frames, monkeypatch):
    attempts = Attempts(monkeypatch, [0.98 * ROOM, 0.98 * ROOM], [10, 25, 12])
    assert attempts.run(solid, frames) == 2
    attempts = Attempts(monkeypatch, [0.98 * ROOM, 0.98 * ROOM], [10, 25, 30])
    assert attempts.run(solid, frames) == 1
    assert len(attempts.aims) == 2
    assert attempts.aims[0] == attempts.aims[1]
    attempts = Attempts(monkeypatch, [0.98 * ROOM], [10, 19])
    assert attempts.run(solid, frames) == 1
    assert len(attempts.aims) == 1


def test_a_size_that_is_never_met_is_an_error(solid, frames, monkeypatch):
    with pytest.raises(EncodeError, match=f"no file of {SIZE} bytes"):
        Attempts(monkeypatch, [1.2 * ROOM] * 3, [10] * 4).run(solid, frames)


def test_one_attempt_unless_it_is_too_large(solid, frames, monkeypatch):
    attempts = Attempts(monkeypatch, [0.5 * ROOM], [])
    assert attempts.run(solid, frames, one_attempt=True) == 1
    attempts = Attempts(monkeypatch, [1.1 * ROOM, 0.9 * ROOM], [])
    assert attempts.run(solid, frames, one_attempt=True) == 2
