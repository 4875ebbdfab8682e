"""Which representation is made, and which is kept."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import trimesh
from control_meshes import square
from places import ROOT
from quietly import encode_quietly

from cndhf_codec.encoder import pipeline, settings
from cndhf_codec.encoder.report import Other
from cndhf_codec.encoder.surface import basis
from cndhf_codec.encoder.surface import settings as surface_settings
from cndhf_codec.errors import EncodeError, MeshError, OptionError

pytestmark = pytest.mark.encode

DHF = replace(
    settings.PRESETS["fast"],
    steps=100,
    batch=512,
    target_resolution=64,
    verify_resolution=32,
    samples=5_000,
    joint_steps=60,
    rounds=1,
    round_steps=10,
)
SURFACE = replace(surface_settings.FAST, trial_rounds=1, rounds=1, samples=2000)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    for preset in ("fast", "default", "best"):
        monkeypatch.setitem(settings.PRESETS, preset, DHF)
        monkeypatch.setitem(settings.SURFACE_PRESETS, preset, SURFACE)
    monkeypatch.setattr(settings, "TRIAL", replace(DHF, target_size=700))
    monkeypatch.setattr(basis, "FINE_FACES", 3000)


@pytest.fixture(scope="module")
def creature() -> trimesh.Trimesh:
    return trimesh.load(ROOT / "examples" / "creature.ply", process=False)


def hollow() -> trimesh.Trimesh:
    inner = trimesh.creation.icosphere(2, 0.7)
    inner.invert()
    return trimesh.util.concatenate([trimesh.creation.icosphere(2), inner])


def test_plans():
    assert settings.plan_for("fast") == settings.Plan(SURFACE, None)
    assert settings.plan_for("default") == settings.Plan(SURFACE, DHF, settings.TRIAL)
    assert settings.plan_for("best") == settings.Plan(SURFACE, DHF, None)
    for preset in ("fast", "default", "best"):
        assert settings.plan_for(preset, "surface") == settings.Plan(SURFACE, None)
        assert settings.plan_for(preset, "dhf") == settings.Plan(None, DHF)
    sized = settings.plan_for("default", target_size=3000)
    assert sized.surface is not None
    assert sized.dhf is not None
    assert sized.surface.target_size == sized.dhf.target_size == 3000


@pytest.mark.parametrize("options", [{"axes": 2}, {"width": 9}])
def test_options_of_height_fields_mean_height_fields(options):
    plan = settings.plan_for("default", **options)
    assert plan.surface is None
    assert plan.dhf == settings.settings_for("default", **options)


def test_the_paper_means_height_fields():
    assert settings.plan_for("paper", steps=7).surface is None
    with pytest.raises(OptionError, match="takes no number of steps"):
        settings.plan_for("default", steps=7)


def test_fast_makes_a_surface_alone(creature):
    model, report = encode_quietly(creature, preset="fast", target_size=900)
    assert (model.representation, report.representation, report.other) == ("surface", "surface", None)
    assert not {"axes", "doubt"} & set(report.seconds)


def test_what_bounds_no_solid_is_a_sheet():
    sheet = square(1)
    model, report = encode_quietly(sheet, target_size=900)
    assert model.representation == "surface"
    assert report.other is not None
    assert (report.other.representation, report.other.how) == ("dhf", "impossible")
    assert any("holds a sheet" in line for line in report.warnings)
    with pytest.raises(MeshError, match="no inside"):
        encode_quietly(sheet, representation="dhf", target_size=900)


@pytest.mark.parametrize("preset", ["default", "best"])
def test_what_height_fields_would_fill_is_a_surface(preset):
    model, report = encode_quietly(hollow(), preset=preset, target_size=900)
    assert model.representation == "surface"
    assert report.other is not None
    assert report.other.how == "at least"
    # The cavity's surface, a third of all, is .3 deep, in one of the two directions.
    assert report.other.mean_error == pytest.approx(0.33 * 0.3 / 2, rel=0.2)
    assert "joint fit" not in report.seconds


@pytest.mark.parametrize(("as_good", "kept"), [(math.inf, "dhf"), (0.0, "surface")])
def test_best_makes_both_and_keeps_the_better(creature, monkeypatch, as_good, kept):
    monkeypatch.setattr(pipeline, "AS_GOOD", as_good)
    monkeypatch.setattr(pipeline, "WORTH_IT", math.inf)
    model, report = encode_quietly(creature, preset="best", target_size=900)
    assert model.representation == report.representation == kept
    assert len(model.dumps()) <= 900
    assert report.other is not None
    assert report.other.how == "encoded"
    assert {report.other.representation, kept} == {"dhf", "surface"}
    assert 0 < report.other.bytes <= 900
    assert report.other.mean_error > 0


@pytest.mark.parametrize(("gain", "how"), [(0.0, "encoded"), (math.inf, "trial")])
def test_default_makes_height_fields_where_a_trial_promises_less_error(creature, monkeypatch, gain, how):
    monkeypatch.setattr(pipeline, "TRIAL_GAIN", gain)
    monkeypatch.setattr(pipeline, "AS_GOOD", 0.0)
    _, report = encode_quietly(creature, target_size=900)
    assert report.other is not None
    assert report.other.how == how


def test_large_files_are_surfaces(creature, monkeypatch):
    monkeypatch.setattr(pipeline, "MOST_TRIED", 800)
    _, report = encode_quietly(creature, target_size=900)
    assert report.other is not None
    assert report.other.how == "untried"
    assert "joint fit" not in report.seconds


def test_a_time_limit_leaves_height_fields_out(creature):
    model, report = encode_quietly(creature, preset="best", target_size=900, time_limit=600)
    assert (model.representation, report.other) == ("surface", None)


def test_to_an_error_the_smaller_file_is_kept(creature, monkeypatch):
    monkeypatch.setattr(pipeline, "WORTH_IT", math.inf)
    sizes = iter([900, 700])
    monkeypatch.setattr(pipeline, "smallest_file", lambda attempt, limit: attempt(next(sizes), 0)[0])
    # These height fields are hardly fitted: at an equal size they would lose.
    model, report = encode_quietly(creature, preset="best", target_error="9%")
    assert model.representation == "dhf"
    assert report.other is not None
    assert len(model.dumps()) <= 700 < report.other.bytes
    assert report.other.mean_error < report.distances.mean


def test_what_no_surface_can_hold_may_be_height_fields(creature, monkeypatch):
    from cndhf_codec.encoder.surface import encode as surface_encode

    def none(*_):
        raise EncodeError("no surface of so few bytes")

    monkeypatch.setattr(surface_encode, "encode_surface", none)
    assert encode_quietly(creature, target_size=900)[0].representation == "dhf"
    with pytest.raises(EncodeError, match="no surface"):
        encode_quietly(creature, preset="fast", target_size=900)
    # Height fields take minutes: a time limit leaves them out, and the reason is the surface's.
    with pytest.raises(EncodeError, match="no surface"):
        encode_quietly(creature, target_size=900, time_limit=600)
    # A sheet can be neither: the reason is the surface's.
    with pytest.raises(EncodeError, match="no surface"):
        encode_quietly(square(2), target_size=900)


def test_the_summary_names_the_other(tmp_path):
    from cndhf_codec.cli.summary import summary

    model, _ = encode_quietly(trimesh.creation.icosphere(2), preset="fast", target_size=900)
    told = {
        "encoded": "in 800 bytes 5 % of the diagonal",
        "trial": "by a short trial about 5 % of the diagonal",
        "at least": "at least 5 % of the diagonal",
        "untried": "not tried, which takes minutes at this size; --preset best does",
        "impossible": "not possible, for it bounds no solid",
    }
    for how, text in told.items():
        model.report.other = Other("dhf", 0.05 * model.report.diagonal, 800, how)
        lines = summary(tmp_path / "a.ply", tmp_path / "a.cndhf", model, False).splitlines()
        assert [line for line in lines if line.startswith("as double height fields: ") and line.endswith(text)]
