"""Encodes from end to end: what comes back, what is reported about it, and that it repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from quietly import encode_quietly
from scipy.spatial import cKDTree
from shapes import lumps, write_every_format

from cndhf_codec import __version__, encode, loads
from cndhf_codec.decoder.meshfile import write_mesh
from cndhf_codec.encoder import check as check_module
from cndhf_codec.encoder import settings
from cndhf_codec.encoder.report import Report
from cndhf_codec.errors import CndhfWarning, InputError, MeshError, OptionError
from cndhf_codec.mesh.bodies import Bodies
from cndhf_codec.mesh.distances import Distances, surface_distances
from cndhf_codec.mesh.read import read_mesh

pytestmark = pytest.mark.encode

# A twentieth of the work of the default preset, and good to about a hundredth of the size.
SMALL = replace(
    settings.PRESETS["fast"],
    max_axes=2,
    width=16,
    steps=500,
    batch=1024,
    target_resolution=192,
    verify_resolution=96,
    target_size=None,
    bits=7.0,
    samples=100_000,
    joint_steps=6000,
    rounds=2,
    round_steps=300,
)


@pytest.fixture(scope="module", params=["bracket", "creature"])
def encoded(request):
    """(input, model, report) of each example."""
    path = request.getfixturevalue(request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(settings.PRESETS, "fast", SMALL)
        return trimesh.load(path), *encode_quietly(
            path, preset="fast", representation="dhf", seed=1, threads=2, source_name=True
        )


def test_the_decoded_mesh_is_the_input_in_place_size_and_form(encoded):
    truth, model, _ = encoded
    mesh = loads(model.dumps()).to_mesh(96)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.euler_number == truth.euler_number  # the bracket's five holes go through
    np.testing.assert_allclose(mesh.bounds, truth.bounds, atol=0.01 * np.linalg.norm(truth.extents))
    assert mesh.volume == pytest.approx(truth.volume, rel=0.05)


def test_inside_is_inside(encoded):
    truth, model, _ = encoded
    lo, hi = truth.bounds
    points = np.random.default_rng(0).uniform(lo, hi, (2000, 3))
    assert (model.contains(points) == truth.contains(points)).mean() > 0.97


def exact_distances(points, mesh) -> np.ndarray:
    """Point-to-triangle distances without igl: exact on the faces of the nearest of many surface samples."""
    samples, face = trimesh.sample.sample_surface(mesh, 500_000, seed=7)
    near = face[cKDTree(samples).query(points, k=15)[1]]
    closest = trimesh.triangles.closest_point(mesh.triangles[near.ravel()], np.repeat(points, 15, axis=0))
    return np.linalg.norm(closest.reshape(-1, 15, 3) - points[:, None], axis=2).min(axis=1)


def test_the_reported_error_is_that_of_the_decoded_mesh(encoded):
    truth, model, report = encoded
    mesh = loads(model.dumps()).to_mesh(SMALL.verify_resolution)
    there = exact_distances(trimesh.sample.sample_surface(truth, 20_000, seed=8)[0], mesh)
    back = exact_distances(trimesh.sample.sample_surface(mesh, 20_000, seed=9)[0], truth)
    d = report.distances
    assert d.mean == pytest.approx((there.mean() + back.mean()) / 2, rel=0.05)
    assert d.p99 == pytest.approx(np.percentile(np.concatenate([there, back]), 99), rel=0.1)
    assert d.p99 < d.maximum < 0.1 * report.diagonal
    assert d.mean < 0.005 * report.diagonal
    assert report.normalised.mean == pytest.approx(d.mean / model.container.scale)


def test_metadata(encoded):
    _, model, report = encoded
    m = loads(model.dumps()).container.metadata
    d = report.distances
    # Rounded up: a file never states less than was measured.
    for stated, measured in ((m.mean_error, d.mean), (m.p99_error, d.p99), (m.max_error, d.maximum)):
        assert measured <= stated <= measured * (1 + 2.0**-7)
    assert m == model.container.metadata
    assert m.encoder == __version__
    assert m.source in ("bracket.ply", "creature.ply")


def test_report(encoded):
    truth, model, report = encoded
    assert (report.faces, report.dropped_faces, report.flipped, report.unknown) == (len(truth.faces), 0, 0, 0)
    assert report.diagonal == pytest.approx(np.linalg.norm(truth.extents))
    assert 0.9 < report.covered <= report.visible <= 1
    assert set(report.seconds) - {"compile"} == {"read", "axes", "fit", "joint fit", "round", "verify"}
    assert len(model.dumps()) < 6000


def test_an_open_mesh_comes_back_closed():
    sphere = trimesh.creation.icosphere(4)
    # The cap above z = 0.8 is missing: a hole of radius 0.6.
    open_sphere = trimesh.Trimesh(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] < 0.8], process=False)
    assert not open_sphere.is_watertight
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(settings.PRESETS, "fast", replace(SMALL, steps=300, verify_resolution=48))
        model, _ = encode_quietly(open_sphere, preset="fast", representation="dhf", threads=2)
    mesh = model.to_mesh(48)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert mesh.euler_number == 2  # no tunnel from the hole through the other side
    cap = np.pi * 0.2**2 * (3 - 0.2) / 3
    assert mesh.volume == pytest.approx(4 / 3 * np.pi - cap, rel=0.06)


@pytest.fixture
def part():
    """A small mesh that needs two axes: an L with a bar across."""
    a, b = trimesh.creation.box((1, 0.3, 0.4)), trimesh.creation.box((0.3, 0.3, 1.2))
    b.apply_translation([0.35, 0, 0.5])
    return a.union(b)


@pytest.mark.usefixtures("tiny")
def test_equal_seeds_give_equal_bytes_whatever_the_threads(part):
    one = encode(part, preset="fast", representation="dhf", seed=5, threads=1).dumps()
    assert encode(part, preset="fast", representation="dhf", seed=5, threads=2).dumps() == one
    assert encode(part, preset="fast", representation="dhf", seed=5).dumps() == one
    assert encode(part, preset="fast", representation="dhf", seed=6, threads=1).dumps() != one


@pytest.mark.usefixtures("tiny")
def test_kinds_of_source_give_one_result(part, tmp_path):
    part.export(tmp_path / "part.ply")
    from_file = encode(tmp_path / "part.ply", preset="fast", representation="dhf")
    reread = trimesh.load(tmp_path / "part.ply", process=False)
    assert from_file.dumps() == encode(reread, preset="fast", representation="dhf").dumps()
    assert from_file.dumps() == encode((reread.vertices, reread.faces), preset="fast", representation="dhf").dumps()
    assert from_file.container.metadata.source is None  # only when asked


@pytest.mark.usefixtures("tiny")
def test_formats_give_equal_bytes(tmp_path):
    first, *_, glb, obj = write_every_format(lumps(), tmp_path)
    expected = encode(first, preset="fast", representation="dhf").dumps()
    assert (first.suffix, glb.suffix, obj.suffix) == (".ply", ".glb", ".obj")
    assert encode(glb, preset="fast", representation="dhf").dumps() == expected
    assert encode(obj, preset="fast", representation="dhf").dumps() == expected


@pytest.mark.usefixtures("tiny")
def test_the_error_is_as_large_anywhere_and_in_any_unit(part, tmp_path):
    errors = []
    for place, size, extension in ((0, 1, "ply"), (1e6, 1, "ply"), (1e6, 1, "glb"), (0, 1e-4, "obj"), (0, 1e6, "ply")):
        given, back = tmp_path / f"in.{extension}", tmp_path / f"out.{extension}"
        mesh = trimesh.Trimesh(part.vertices * size + [place, -place, 0], part.faces, process=False)
        write_mesh(mesh, given, overwrite=True)
        model, report = encode_quietly(given, preset="fast", representation="dhf", axes=1)
        write_mesh(model.to_mesh(32), back, overwrite=True)
        result = read_mesh(back)
        d = surface_distances(mesh.vertices, mesh.faces, result.vertices, result.faces, samples=20_000)
        assert d.mean == pytest.approx(report.distances.mean, rel=0.1)
        errors.append(d.mean / report.diagonal)
    # The inputs differ by rounding, and short fits that start from such differences do not end in the same place.
    assert max(errors) < 2 * min(errors)


@pytest.mark.usefixtures("tiny")
def test_place_and_size_do_not_matter(part):
    # Powers of two and coordinates on a lattice: nothing is rounded, so that the fits are equal to the bit.
    vertices = np.round(part.vertices * 2**10) / 2**10
    moved = vertices * 1024 + [2.0**20, 0, -(2.0**21)]
    a, b = (
        encode((vertices, part.faces), preset="fast", representation="dhf"),
        encode((moved, part.faces), preset="fast", representation="dhf"),
    )
    assert b.container.scale == 1024 * a.container.scale
    assert b.container.centre == tuple(np.array(a.container.centre) * 1024 + [2.0**20, 0, -(2.0**21)])
    assert b.container.metadata.mean_error == pytest.approx(1024 * a.container.metadata.mean_error, rel=1e-3)
    for x, y in zip(a.container.dhfs, b.container.dhfs, strict=True):
        assert (x.quaternion, x.box, x.step_codes) == (y.quaternion, y.box, y.step_codes)
        assert all(np.array_equal(s, t) for s, t in zip(x.symbols, y.symbols, strict=True))


@pytest.mark.usefixtures("tiny")
def test_options_reach_the_model(part):
    model = encode(part, preset="fast", representation="dhf", axes=1, width=9)
    assert [(d.width, d.hidden_layers) for d in model.container.dhfs] == [(9, 5)]


@pytest.mark.usefixtures("tiny")
def test_progress_goes_through_the_stages_in_order(part):
    seen = []
    encode(
        part,
        preset="fast",
        representation="dhf",
        progress=lambda stage, done, total, loss=np.nan: seen.append((stage, done, total)),
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in seen))
    assert stages == ["read", "axes", "fit", "joint fit", "round", "verify"]
    for stage in stages:
        steps = [(done, total) for s, done, total in seen if s == stage]
        assert steps[0][0] == 0
        assert steps[-1][0] == steps[-1][1]
        # Rounding starts again when a file is too large or holds a floater.
        assert stage == "round" or [d for d, _ in steps] == sorted(d for d, _ in steps)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preset": "slow"}, "preset"),
        ({"axes": 0}, "axes"),
        ({"width": 1000}, "width"),
        ({"threads": 0}, "threads"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**32}, "seed"),
        ({"threads": 1.5}, "threads is 1.5; a whole number"),
        ({"seed": "1"}, "seed is '1'; a whole number"),
        ({"axes": True}, "axes is True; a whole number"),
        ({"width": [8]}, r"width is \[8\]; a whole number"),
        ({"preset": 3}, "preset is 3; there are"),
        ({"target_size": 4096.5}, "target size is 4096.5"),
        ({"target_size": "4 apples"}, "target size is '4 apples'"),
        ({"target_error": object}, "target error is"),
        ({"thicken": "thick"}, "thickness is 'thick'"),
        ({"time_limit": "soon"}, "time limit is 'soon'"),
        ({"time_limit": float("nan")}, "time limit is nan"),
        ({"unit": 3, "thicken": 1}, "unit is 3"),
    ],
)
def test_options_are_checked_before_the_mesh_is_read(options, message):
    with pytest.raises(OptionError, match=message):
        encode("no such file.ply", **options)


def test_meshes_that_bound_no_solid(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        encode(tmp_path / "gone.ply")
    with pytest.raises(MeshError):
        encode((np.zeros((3, 3)), [[0, 1, 2]]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rocker-arm", "stanford-bunny"])
def test_corpus(corpus, name):
    truth = trimesh.load(corpus / f"{name}.ply")
    mesh = encode(corpus / f"{name}.ply", preset="fast", representation="dhf").to_mesh(256)
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds, truth.bounds, atol=0.005 * np.linalg.norm(truth.extents))
    volumes = sorted(abs(p.volume) for p in mesh.split(only_watertight=False))
    assert sum(volumes[:-1]) <= 0.001 * volumes[-1]


def test_a_result_far_from_the_input_is_told():
    report = Report(SMALL, visible=1.0, diagonal=2.0, distances=Distances(0.06, 0.2, 0.3))
    assert report.warnings == ["the result is far from the input, 3.0 % of its diagonal on average; try another --seed"]
    assert replace(report, distances=Distances(0.05, 0.2, 0.3)).warnings == []
    assert len(replace(report, visible=0.8).warnings) == 1  # a fifth is hidden, which is told and explains it


def changed(given: Bodies, made: Bodies) -> list[str]:
    return Report(settings.PRESETS["fast"], visible=1.0, bodies=given, decoded=made).warnings


def test_parts_and_volume_that_change_are_told():
    assert changed(Bodies(1, 0, 1.0), Bodies(1, 0, 1.015)) == []
    assert changed(Bodies(3, 5, 1.0), Bodies(3, 2, 0.99)) == []
    (lost,) = changed(Bodies(36, 0, 1.0), Bodies(35, 0, 1.0))
    assert lost.startswith("the input has 36 parts, the result 35 parts: some are lost or have grown together")
    (apart,) = changed(Bodies(1, 0, 1.0), Bodies(2, 0, 1.0))
    assert apart.startswith("the input has 1 part, the result 2 parts: some have come apart")
    assert changed(Bodies(1, 0, 1.0), Bodies(1, 7, 1.0)) == ["the result has 7 specks that the input has not"]
    assert changed(Bodies(300, 0, 1.0, 0.05, closed=False), Bodies(1, 0, 1.06)) == []
    assert changed(Bodies(1, 0, 8.0), Bodies(1, 0, 7.0)) == [
        "the volume of the result is 7, that of the input 8 (-12.5 %)"
    ]


@pytest.mark.usefixtures("tiny")
def test_encode_warns_in_python_of_what_it_assumed():
    hollow = trimesh.util.concatenate([trimesh.creation.icosphere(3), trimesh.creation.icosphere(3, 0.5)])
    hollow.faces[len(hollow.faces) // 2 :] = hollow.faces[len(hollow.faces) // 2 :, ::-1]
    with pytest.warns(CndhfWarning, match="hidden from every axis"):
        encode(hollow, preset="fast", representation="dhf")


def test_check_foretells_a_refusal_for_being_unseen(monkeypatch):
    class Blind(check_module.AxisCosts):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            self.visible = 0.0

    monkeypatch.setattr(check_module, "AxisCosts", Blind)
    assert "no axis sees any of its surface" in str(check_module.check(trimesh.creation.box()).refusal)
