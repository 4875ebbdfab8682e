"""Queries on models whose solid is known, in input coordinates."""

from __future__ import annotations

import json

import analytic
import numpy as np
import pytest
import rawfile
from analytic import ABOUT_X_180, ABOUT_Y_90, ABOUT_Z_45, slab
from scipy.spatial.transform import Rotation

from cndhf_codec import load, loads
from cndhf_codec.decoder.dhf import representation
from cndhf_codec.errors import ChecksumError, InputError, LimitError, OptionError, OutputError

LO, HI = np.array([-0.5, -0.25, -0.125]), np.array([0.25, 0.5, 0.375])


def in_box(points, lo=LO, hi=HI):
    return np.all((points >= lo) & (points <= hi), axis=-1)


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-0.8, 0.8, (4000, 3))


def test_a_constant_network_is_a_box(points):
    assert np.array_equal(analytic.model(slab(LO, HI)).contains(points), in_box(points))


def test_implicit_of_a_box_is_the_distance_inside_and_negative_outside(points):
    f = analytic.model(slab(LO, HI)).implicit(points)
    inside = in_box(points)
    depth = np.minimum(points - LO, HI - points).min(axis=1)
    np.testing.assert_allclose(f[inside], depth[inside], atol=1e-6)
    assert f[~inside].max() < 0


def test_the_surface_belongs_to_the_solid():
    m = analytic.model(slab(LO, HI))
    assert m.contains([LO, HI, [0, 0, HI[2]], [LO[0], 0, 0]]).all()


@pytest.mark.parametrize("quaternion", [ABOUT_X_180, ABOUT_Y_90, ABOUT_Z_45, (9000, -14000, 20000, 20000)])
def test_rotation_takes_points_to_the_frame_of_the_heights(quaternion, points):
    # An independent reading of "x y z w; R p is the point in the DHF's frame".
    R = Rotation.from_quat(quaternion).as_matrix()
    f = analytic.model(slab(LO, HI, quaternion)).implicit(points)
    sure = np.abs(f) > 1e-5
    assert np.array_equal(f[sure] > 0, in_box(points @ R.T)[sure])


def test_the_axis_opposite_to_z_turns_heights_upside_down():
    m = analytic.model(slab(LO, HI, ABOUT_X_180))
    assert m.info["dhfs"][0]["axis"] == [0, 0, -1]
    assert m.contains([[0.1, -0.2, -0.3], [0.1, -0.2, 0.3], [0.1, 0.4, -0.3]]).tolist() == [True, False, False]


def test_several_dhfs_intersect(points):
    a, b = slab(LO, HI), slab((-0.125, -0.5, -0.5), (0.5, 0.5, 0.5))
    both = in_box(points) & in_box(points, (-0.125, -0.5, -0.5), (0.5, 0.5, 0.5))
    assert np.array_equal(analytic.model(a, b).contains(points), both)


def test_centre_and_scale(points):
    centre, scale = (1e6, -2e6, 3e6), 400.0
    plain, placed = analytic.model(slab(LO, HI)), analytic.model(slab(LO, HI), centre=centre, scale=scale)
    moved = points * scale + centre
    f = plain.implicit(points)
    np.testing.assert_allclose(placed.implicit(moved), f * scale, atol=1e-3)  # float64 has 1e-10 here
    sure = np.abs(f) > 1e-5
    assert np.array_equal(placed.contains(moved)[sure], in_box(points)[sure])


def test_a_domain_box_ends_the_solid_in_z_too():
    record = slab((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    cut = type(record)(**{**vars(record), "box": (*record.box[:4], -4096, 2048)})  # z from -1/4 to 1/8
    m = analytic.model(cut)
    assert m.contains([[0, 0, 0.12], [0, 0, 0.13], [0, 0, -0.24], [0, 0, -0.26]]).tolist() == [True, False] * 2


def test_heights_are_near_then_far_in_the_normalised_frame():
    m = analytic.model(slab(LO, HI), centre=(100, 200, 300), scale=50)
    assert m.heights(0, [0.1, 0.1]).tolist() == [-0.125, 0.375]


def test_shapes_of_points_are_kept(points):
    m = analytic.model(analytic.waves(4))
    flat = m.implicit(points[:24])
    assert m.implicit(points[:24].reshape(2, 3, 4, 3)).shape == (2, 3, 4)
    np.testing.assert_allclose(m.implicit(points[:24].reshape(2, 12, 3)).ravel(), flat, atol=1e-6)
    assert m.implicit(points[0]).shape == m.contains(points[0]).shape == ()
    assert m.implicit(np.empty((0, 3))).shape == (0,)
    assert m.heights(0, np.zeros((4, 5, 2))).shape == (4, 5, 2)
    assert m.contains(points[:2].tolist()).dtype == bool
    assert m.contains([[0, 0, 0]]).tolist() == [True]


def test_points_in_several_chunks(monkeypatch, points):
    m = analytic.model(analytic.waves(4))
    whole = m.implicit(points)
    monkeypatch.setattr(representation.DhfRepresentation, "points_at_once", 1000)
    np.testing.assert_allclose(m.implicit(points), whole, atol=1e-6)


@pytest.mark.parametrize("shape", [(), (2,), (4,), (5, 2), (3, 4)])
def test_wrong_shapes(shape):
    m = analytic.model(slab(LO, HI))
    with pytest.raises(OptionError, match=r"\(\.\.\., 3\)"):
        m.implicit(np.zeros(shape))
    with pytest.raises(OptionError, match=r"\(\.\.\., 3\)"):
        m.contains(np.zeros(shape))
    if shape[-1:] != (2,):
        with pytest.raises(OptionError, match=r"\(\.\.\., 2\)"):
            m.heights(0, np.zeros(shape))


@pytest.mark.parametrize("points", ["abc", ["a", "b", "c"], [[0, 0, 0], [0, 0]], [1j, 0, 0], None])
def test_points_that_are_no_numbers(points):
    model = analytic.model(slab(LO, HI))
    for ask in (model.contains, model.implicit, model.normals, lambda p: model.heights(0, p)):
        with pytest.raises(OptionError, match="numbers of shape"):
            ask(points)


def test_numbers_of_any_kind_in_any_order(points):
    model = analytic.model(slab(LO, HI))
    coarse = np.round(points.astype(np.float32) * 8).reshape(-1, 2, 3) / 8
    expected = model.implicit(coarse)
    assert np.array_equal(model.implicit(coarse.astype(np.float16)), expected)
    assert np.array_equal(model.implicit(coarse.tolist()), expected)
    assert np.array_equal(model.implicit(np.asfortranarray(coarse)), expected)
    assert np.array_equal(model.implicit(np.repeat(coarse, 2, axis=1)[:, ::2]), expected)
    whole = np.round(coarse).astype(np.int8)
    assert np.array_equal(model.contains(whole), model.contains(whole.astype(np.float64)))
    one = model.contains([0, 0, 0])
    assert (type(one), one.shape, one.dtype) == (np.ndarray, (), bool)


@pytest.mark.parametrize("i", [-1, 1])
def test_there_is_no_such_dhf(i):
    with pytest.raises(OptionError, match=f"no DHF {i}"):
        analytic.model(slab(LO, HI)).heights(i, [0, 0])


def test_points_that_are_not_finite_are_outside():
    with np.errstate(invalid="ignore"):
        inside = analytic.model(slab(LO, HI)).contains([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]])
    assert inside.tolist() == [False, False, False]


def test_info_in_plain_values(tmp_path):
    m = analytic.model(slab(LO, HI), slab(LO, HI, ABOUT_Y_90), centre=(1, 2, 3), scale=4)
    m.save(tmp_path / "a.cndhf")
    info = json.loads(json.dumps(m.info))
    assert info["bytes"] == (tmp_path / "a.cndhf").stat().st_size
    assert info["parameters"] == 2 * 9
    assert info["bits_per_parameter"] == pytest.approx(8 * info["bytes"] / 18)
    assert (info["centre"], info["scale"]) == ([1, 2, 3], 4)
    # A quarter turn about y takes -x to +z.
    assert [d["axis"] for d in info["dhfs"]] == [[0, 0, 1], [-1, 0, 0]]
    assert info["dhfs"][0]["bounds"] == [[-0.5, 0.25], [-0.25, 0.5], [-0.375, 0.625]]
    assert info["mean_error"] is info["source"] is info["encoder"] is None


def test_info_gives_the_size_of_the_file_and_not_of_a_copy():
    # This decoder does not know the section, so a copy would leave it out.
    data = rawfile.build([rawfile.fields(), (0x90, bytes(1000))])
    assert loads(data).info["bytes"] == len(data)


def test_save_and_load(tmp_path, points):
    m = analytic.model(analytic.waves(5), centre=(1, 2, 3), scale=0.5)
    m.save(tmp_path / "a.cndhf")
    for back in (load(tmp_path / "a.cndhf"), load(str(tmp_path / "a.cndhf")), loads(m.dumps())):
        assert back.dumps() == m.dumps()
        assert np.array_equal(back.implicit(points), m.implicit(points))


def test_errors_name_the_file(tmp_path):
    m = analytic.model(slab(LO, HI))
    path = tmp_path / "a.cndhf"
    with pytest.raises(InputError, match=r"a\.cndhf"):
        load(path)
    m.save(path)
    with pytest.raises(OutputError, match=r"a\.cndhf.*overwrite"):
        m.save(path)
    path.write_bytes(m.dumps()[:-1])
    with pytest.raises(ChecksumError, match=r"a\.cndhf"):
        load(path)


def test_a_file_too_large_is_not_read_whole(tmp_path):
    path = tmp_path / "big.cndhf"
    with open(path, "wb") as file:
        file.truncate(2**40)  # sparse: reading it all would need a terabyte
    with pytest.raises(LimitError, match=r"big\.cndhf.*more than"):
        load(path)


def test_gradient_is_the_slope_of_the_implicit_function(points):
    m = analytic.model(analytic.waves(4), analytic.waves(5, (9000, -14000, 20000, 20000)), centre=(1, -2, 3), scale=2.5)
    moved = points * 2.5 + [1, -2, 3]
    f, gradient = m.implicit(moved.reshape(40, 100, 3), gradient=True)
    assert (f.shape, gradient.shape, gradient.dtype) == ((40, 100), (40, 100, 3), np.float32)
    assert np.array_equal(f.ravel(), m.implicit(moved))
    step = 2e-3
    for k in range(3):
        shift = np.eye(3)[k] * step
        # On both sides: where they differ, a crease lies between them.
        ahead, behind = (m.implicit(moved + shift) - f.ravel()) / step, (f.ravel() - m.implicit(moved - shift)) / step
        smooth = np.abs(ahead - behind) < 0.02
        assert smooth.mean() > 0.9
        np.testing.assert_allclose(gradient.reshape(-1, 3)[smooth, k], (ahead + behind)[smooth] / 2, atol=0.02)


def test_gradient_on_the_planes_of_a_box_points_inward():
    f, gradient = analytic.model(slab(LO, HI, ABOUT_Z_45)).implicit([[0, 0, 0.374], [0, 0, -0.124]], gradient=True)
    np.testing.assert_allclose(f, 1e-3, atol=1e-6)
    np.testing.assert_allclose(gradient, [[0, 0, -1], [0, 0, 1]], atol=1e-6)
