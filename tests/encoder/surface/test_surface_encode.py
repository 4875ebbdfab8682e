"""Surfaces from end to end: sizes kept to, equal bytes, odd inputs, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from math import inf
from pathlib import Path

import numba
import numpy as np
import pytest
import trimesh
from control_meshes import arrays, square, target_of
from quietly import encode_quietly
from shapes import lumps

from cndhf_codec import CndhfError, CndhfWarning, encode, load, loads
from cndhf_codec.encoder import settings as encoder_settings
from cndhf_codec.encoder.deadline import Deadline
from cndhf_codec.encoder.surface import basis, settings, to_size
from cndhf_codec.encoder.surface.cut import cut
from cndhf_codec.encoder.surface.encode import encode_surface
from cndhf_codec.encoder.surface.to_size import surface_of_size
from cndhf_codec.errors import EncodeError, OptionError
from cndhf_codec.format.surface import section
from cndhf_codec.format.surface.section import decode_surface

pytestmark = pytest.mark.encode

QUICK = replace(settings.FAST, trial_rounds=1, rounds=2, samples=3000)


def make_quick(patch: pytest.MonkeyPatch) -> None:
    """A tenth of the work of the preset `fast`, for tests of sizes and kinds of mesh."""
    patch.setitem(encoder_settings.SURFACE_PRESETS, "fast", QUICK)
    patch.setattr(basis, "FINE_FACES", 3000)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    make_quick(monkeypatch)


def no_stage(name, total):
    return lambda done, loss: None


def made(source, size: int | str | None = None, **options):
    return encode_quietly(source, preset="fast", representation="surface", target_size=size, **options)


def bumpy(detail: int = 5) -> trimesh.Trimesh:
    """A ball with more bumps than a small file can hold."""
    ball = trimesh.creation.icosphere(detail)
    x, y, z = ball.vertices.T
    ball.vertices *= (1 + 0.06 * np.sin(9 * x) * np.sin(8 * y + 1) * np.sin(7 * z + 2))[:, None]
    return ball


@pytest.mark.parametrize("size", [300, 1500])
@pytest.mark.parametrize("shape", [bumpy(4), lumps()], ids=["bumpy", "lumps"])
def test_a_section_is_never_larger_than_allowed(shape, size):
    shape = shape.copy()
    shape.apply_scale(1 / np.abs(shape.vertices).max())
    given = arrays(shape)
    sized = surface_of_size(cut(*given), target_of(shape, 4000), size, QUICK, no_stage, Deadline(inf))
    body = section.encode_surface(sized.mesh)
    assert len(body) <= sized.n_bytes <= size
    back = decode_surface(body)
    assert len(back.faces) == len(sized.mesh.faces)
    assert back.step == sized.mesh.step


@pytest.mark.parametrize("size", ["1KiB", 3000])
def test_a_file_is_nearly_as_large_as_allowed(size):
    model, report = made(bumpy(), size)
    most = {"1KiB": 1024}.get(size, size)
    assert 0.9 * most <= len(model.dumps()) <= most
    assert report.distances.mean < 0.01 * report.diagonal
    again = loads(model.dumps())
    assert again.representation == "surface"
    assert again.dumps() == model.dumps()


def test_a_larger_file_is_better():
    errors = [made(bumpy(), size)[1].distances.mean for size in (600, 1500)]
    assert errors[0] > 1.2 * errors[1]


def test_equal_bytes_whatever_the_threads():
    one = made(lumps(), 700, threads=1, seed=5)[0].dumps()
    assert made(lumps(), 700, threads=2, seed=5)[0].dumps() == one
    assert made(lumps(), 700, seed=5)[0].dumps() == one
    most = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert made(lumps(), 700, seed=5)[0].dumps() == one
    finally:
        numba.set_num_threads(most)
    assert numba.get_num_threads() == most


ENCODE = """
import sys, warnings
warnings.simplefilter("ignore")
sys.path[:0] = sys.argv[2:]
import cndhf_codec, pytest, test_surface_encode
test_surface_encode.make_quick(pytest.MonkeyPatch())
model = cndhf_codec.encode(sys.argv[1], preset="fast", representation="surface", target_size=700)
sys.stdout.buffer.write(model.dumps())
"""


def test_equal_bytes_in_another_process_with_one_thread(tmp_path):
    lumps().export(tmp_path / "lumps.ply")
    here = made(tmp_path / "lumps.ply", 700)[0].dumps()
    root = Path(__file__).parents[3]
    given = [str(tmp_path / "lumps.ply"), str(root / "tests"), str(Path(__file__).parent)]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "PYTHONPATH": str(root)}
    done = subprocess.run([sys.executable, "-c", ENCODE, *given], env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout == here


def test_a_cube_of_12_faces_is_exact():
    model, report = made(trimesh.creation.box((1, 2, 3)), 1000)
    assert report.distances.mean < 1e-4
    assert len(model.dumps()) <= 1000
    mesh = model.to_mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(6, rel=1e-3)


def test_a_single_triangle():
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    model, report = made((corners, [(0, 1, 2)]))
    assert len(model.container.surface.faces) == 1
    # The limit rounds the corners of the rim off, for which no mark can be set: there is no other edge.
    assert report.distances.mean < 0.05 * report.diagonal


def test_an_open_sheet_stays_open():
    wavy = square(30)
    wavy.vertices[:, 2] = 0.1 * np.sin(6 * wavy.vertices[:, 0])
    model, report = made(wavy, 800)
    mesh = model.to_mesh()
    assert not mesh.is_watertight
    assert mesh.euler_number == 1
    assert mesh.area == pytest.approx(wavy.area, rel=0.01)
    assert report.distances.mean < 0.002 * report.diagonal


def test_a_cavity_stays():
    outer, inner = trimesh.creation.icosphere(3), trimesh.creation.icosphere(3, 0.5)
    inner.invert()
    model, _ = made(trimesh.util.concatenate([outer, inner]), 800)
    mesh = model.to_mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * (1 - 0.5**3), rel=0.02)
    assert model.contains([[0, 0, 0.75], [0, 0, 0.1]]).tolist() == [True, False]


def test_many_small_parts_in_a_small_file():
    # 44 balls in 500 bytes: most must go, and the file must still be made.
    balls = []
    for k in range(44):
        ball = trimesh.creation.icosphere(1, 0.3 * (1 + k % 5))
        ball.apply_translation((4 * (k % 7), 4 * (k // 7), 0))
        balls.append(ball)
    model, _ = made(trimesh.util.concatenate(balls), 500)
    assert len(model.dumps()) <= 500
    whole, _ = made(trimesh.util.concatenate(balls), 4000)
    assert whole.to_mesh().body_count == 44


def test_a_whole_mesh_that_does_not_fit_is_simplified():
    # Random heights have nothing to predict: all faces as they are take more than the size, and fewer fit.
    rough = square(9)
    rough.vertices[:, 2] = np.random.default_rng(0).normal(size=len(rough.vertices))
    for size in (400, 450, 500):
        assert len(made(rough, size)[0].dumps()) <= size


def test_target_error_makes_a_file_that_keeps_to_it():
    model, report = made(lumps(), target_error="1%")
    assert report.distances.mean <= 0.01 * report.diagonal
    larger, better = made(lumps(), target_error="0.5%")
    assert better.distances.mean <= 0.005 * report.diagonal
    assert len(model.dumps()) <= len(larger.dumps())


@pytest.mark.parametrize("size", [90, 130])
def test_a_size_that_holds_no_surface(size):
    # Smaller than any that the options allow, as a long source name makes it.
    given = arrays(lumps())
    with pytest.raises(EncodeError, match="use a larger size"):
        encode_surface(*given, replace(QUICK, target_size=size), 95, 0, no_stage, Deadline(inf))


class Hourglass(Deadline):
    """A deadline by another clock: so many seconds pass with each look at what has gone."""

    def __init__(self, seconds: float, look: float) -> None:
        self._seconds, self._look, self._gone = seconds, look, 0.0

    def gone(self) -> float:
        self._gone += self._look
        return self._gone

    def left(self) -> float:
        return self._seconds - self._gone


def test_a_time_limit_lets_through_what_there_is_time_for(monkeypatch):
    rounds = []
    fit_with_creases = to_size.fit_with_creases
    monkeypatch.setattr(
        to_size, "fit_with_creases", lambda *args: [rounds.append(args[-2]), fit_with_creases(*args)][1]
    )
    many = replace(QUICK, rounds=8, target_size=600, other_counts=(0.9, 1.1), tries=4)
    given = arrays(lumps())
    encode_surface(*given, many, 50, 0, no_stage, Deadline(inf))
    everything = len(rounds)
    assert everything >= 3
    assert rounds == [8] * everything
    rounds.clear()
    # After the first try 3.5 seconds remain: two for the next, and a quarter for each of its rounds.
    encode_surface(*given, many, 50, 0, no_stage, Hourglass(5.5, 1))
    assert rounds == [6, 2, 0]
    rounds.clear()
    encode_surface(*given, many, 50, 0, no_stage, Hourglass(4.5, 1))
    assert rounds == [2, 0]
    with pytest.raises(EncodeError, match="the time limit is too short for a surface of this size"):
        encode_surface(*given, many, 50, 0, no_stage, Hourglass(2.5, 1))


def test_progress_goes_through_the_stages():
    seen = []
    made(lumps(), 500, progress=lambda stage, done, total, loss=np.nan: seen.append((stage, done, total)))
    assert list(dict.fromkeys(stage for stage, _, _ in seen)) == ["read", "simplify", "fit", "verify"]
    assert all(0 <= done <= total for _, done, total in seen)


@pytest.mark.parametrize("options", [{"axes": 2}, {"width": 8}, {"steps": 100}, {"preset": "paper"}])
def test_options_of_height_fields_are_refused(options):
    with pytest.raises(OptionError, match="representation 'surface'") as caught:
        encode("no such file.ply", **{"representation": "surface", **options})
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(OptionError, match="representation is 'mesh'; there are auto, dhf, surface"):
        encode("no such file.ply", representation="mesh")


def test_the_commands(tmp_path):
    lumps().export(tmp_path / "in.ply")
    commands = Path(sys.executable).parent
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    for line in (
        [
            "cndhf-encode",
            "in.ply",
            "out.cndhf",
            "--representation",
            "surface",
            "--preset",
            "fast",
            "--target-size",
            "600",
        ],
        ["cndhf-decode", "out.cndhf", "back.ply"],
    ):
        done = subprocess.run(
            [commands / line[0], *line[1:]],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.cndhf").stat().st_size <= 600
    assert load(tmp_path / "out.cndhf").representation == "surface"
    back = trimesh.load(tmp_path / "back.ply")
    np.testing.assert_allclose(back.bounds, lumps().bounds, atol=0.1)


def test_dirty_meshes_encode_or_are_refused_in_one_line(corpus):
    files = sorted(corpus.glob("dirty-*"))
    assert files
    refusals: dict[str, str] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CndhfWarning)
        for file in files:
            try:
                model = encode(file, preset="fast", representation="surface", target_size=1500)
            except CndhfError as refusal:
                refusals[file.name] = str(refusal)
            else:
                assert len(model.dumps()) <= 1500, file
                assert loads(model.dumps()).representation == "surface"
    for name, line in refusals.items():
        assert len(line.splitlines()) == 1, name
