"""Choice of axes by costs and by trials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from jointly import SMALL, job_of, quiet

from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.dhf.axes import trials
from cndhf_codec.encoder.dhf.axes.costs import AxisCosts
from cndhf_codec.encoder.dhf.axes.trials import Trial, TrialRound
from cndhf_codec.encoder.dhf.job import Plan
from cndhf_codec.encoder.dhf.widths import widths_for
from cndhf_codec.encoder.thread_pool import ThreadPool
from cndhf_codec.mesh.read import read_mesh
from cndhf_codec.mesh.solid import Solid

pytestmark = pytest.mark.encode


def test_axes_are_chosen_by_what_they_leave(solid):
    costs = AxisCosts(solid, 0, ThreadPool(1))
    (first,) = costs.best(1)
    # The T's silhouette is along y; every other axis fills something in or sees more of it slantwise.
    assert abs(costs.axes[first][1]) > 0.5
    assert costs.mean_cost(costs.best(2)) < costs.mean_cost([first])
    free, *others = costs.sets(2)
    assert free == costs.best(2)
    aligned = set(range(len(costs.axes) - 6, len(costs.axes)))
    assert aligned & set(free) or aligned & set(others[0])
    assert all(costs.mean_cost(free) <= costs.mean_cost(o) for o in others)
    assert costs.visible == pytest.approx(1, abs=0.01)
    assert sum(costs.shares(costs.best(3))) == pytest.approx(1)


def test_a_longer_trial_decides_between_the_best_sets_of_axes(solid, monkeypatch):
    short: list[Plan] = []
    long: list[Plan] = []

    def trial(job, plan, steps, deadline, start):
        assert start == (None if steps == SMALL.trial_steps else plan.shares[0])
        tried, errors = (short, (0.2, 0.1)) if steps == SMALL.trial_steps else (long, (0.09, 0.05))
        tried.append(plan)
        # The first set looks bad at once, and the better of those tried for longer is the second.
        return Trial(
            plan.error_lower_bound + errors[min(len(tried) - 1, 1)],
            [1.0] * (len(plan.frames) - 1) + [0.2],
            plan.shares[0],
        )

    monkeypatch.setattr(trials, "_trial", trial)
    job = job_of(solid, replace(SMALL, target_size=16384))
    plan = trials.make_plan(job, Deadline())
    assert len(short) > len(long) == trials.FINALISTS
    assert all(p is not short[0] for p in long)
    assert plan.frames is long[1].frames
    # The widths follow what each field answered for in the trial.
    assert plan.widths == widths_for(job.settings, plan.shares, 30) != long[1].widths
    assert plan.widths[-1] < plan.widths[0]


def test_threads_do_not_change_which_trials_count(solid, monkeypatch):
    # The second plan is spared by the first one, though beside it there is a thread for it.
    bounds, tried = [0.01, 0.3, 0.02, 0.25, 0.2], []
    plans = [Plan([None] * 2, [0.5] * 2, [9] * 2, bound, 1.0, 1.0) for bound in bounds]

    def trial(job, plan, steps, deadline, start):
        tried.append(plan.error_lower_bound)
        return Trial(plan.error_lower_bound + 0.1, plan.shares, None)

    monkeypatch.setattr(trials, "_trial", trial)
    results = []
    for threads in (1, 2, 5):
        tried.clear()
        with ThreadPool(threads) as pool:
            job = replace(job_of(solid, SMALL), threads=pool)
            results.append(trials._compare(job, plans, [None] * 5, TrialRound(10, 1.0, 0), Deadline(), quiet))
        assert sorted(tried) == ([0.01, 0.02] if threads == 1 else [0.01, 0.02, 0.3])
    errors = results[0][0]
    assert errors == pytest.approx([0.11, np.inf, 0.12, np.inf, np.inf])
    assert all(r[0] == errors for r in results)


def test_of_equal_trials_the_one_with_more_axes_is_chosen(solid, monkeypatch):
    monkeypatch.setattr(trials, "_trial", lambda job, plan, steps, deadline, start: Trial(0.1, plan.shares, None))
    monkeypatch.setattr(AxisCosts, "error_lower_bound", lambda self, chosen: 0.01)
    job = job_of(solid, replace(SMALL, target_size=4096, max_axes=3))
    assert len(trials.make_plan(job, Deadline()).frames) == 3


def test_a_width_is_taken_as_given(solid):
    # 4 is the least that the options allow, less than what a size would be met with.
    plan = trials.make_plan(job_of(solid, replace(SMALL, target_size=None, width=4, trial_steps=0)), Deadline())
    assert plan.widths == [4] * len(plan.frames)


def slotted() -> Solid:
    """A cube of side 1 with a slot 1/2 deep in x, as wide as the cube in y, and 1/5 high."""
    cube = trimesh.creation.box((1, 1, 1))
    slot = trimesh.creation.box((0.5, 2, 0.2), trimesh.transformations.translation_matrix((0.25001, 0, 0)))
    mesh = read_mesh(trimesh.boolean.difference([cube, slot], engine="manifold").subdivide())
    return Solid(mesh.vertices, mesh.faces)


def test_the_error_lower_bound_is_what_the_exact_heights_fill():
    solid = slotted()
    costs = AxisCosts(solid, 0, ThreadPool(1))
    y, z = range(len(costs.axes) - 5, len(costs.axes) - 3)
    # Along y the slot is seen; along z it is filled, up to 0.4 above its ceiling and below its floor. Of its back
    # wall, seen edge-on, 0.4 to 0.5 count by the least cosine. Seen in one of two directions: half.
    hidden = 2 * 0.5 * 0.4 + 0.2 * 0.45 * 0.3
    assert costs.error_lower_bound([y]) == 0
    assert costs.error_lower_bound([z]) == pytest.approx(hidden / 2 / solid.areas.sum(), rel=0.05)
    assert costs.error_lower_bound([y, z]) == 0


def test_sets_that_must_leave_more_than_others_reach_are_not_tried(monkeypatch):
    solid = slotted()
    tried: list[float] = []

    def trial(job, plan, steps, deadline, start):
        tried.append(plan.error_lower_bound)
        return Trial(plan.error_lower_bound + 0.001, plan.shares, None)

    def bounds_tried(*sets: int) -> list[float]:
        """Error lower bounds of the plans, in the order of trials. sets: axes from the end; the last is tried first."""
        tried.clear()
        monkeypatch.setattr(AxisCosts, "sets", lambda self, count: [[len(self.axes) - k] for k in sets])
        trials.make_plan(job_of(solid, replace(SMALL, target_size=1024, max_axes=1)), Deadline())
        return tried

    monkeypatch.setattr(trials, "mirror_planes", lambda solid, seed: [])  # else these have candidates of their own
    monkeypatch.setattr(trials, "_trial", trial)
    y, z = 5, 4  # along z the slot is filled
    assert bounds_tried(y, z) == [pytest.approx(0.031, abs=0.003), 0.0]
    assert bounds_tried(z, y) == [0.0]


@pytest.mark.parametrize("bound", [0.0, 0.01])
def test_more_axes_have_more_to_learn_after_a_trial(bound):
    def predicted(axes: int, trial: float) -> float:
        plan = Plan([None] * axes, [1 / axes] * axes, [9] * axes, bound, 1.0, 1.0)
        return trials.predicted_error(plan, trial, trials.SHRINK)

    errors = [predicted(axes, 0.05) for axes in (1, 2, 3, 4)]
    assert errors == sorted(errors, reverse=True)
    # Two axes more are worth a trial's error that is a tenth worse, less what nothing can learn.
    assert predicted(4, bound + 1.1 * (0.05 - bound)) < predicted(2, 0.05) < predicted(4, bound + 1.2 * (0.05 - bound))
    assert predicted(3, bound) == pytest.approx(bound)
