"""Arguments of wrong types are an OptionError that says what is needed, and never a bare TypeError or ValueError."""

from __future__ import annotations

import io
import pickle

import numpy as np
import pytest

from cndhf_codec import Limits, Model, load, loads, loads_prefix
from cndhf_codec.decoder.gridfile import write_grid
from cndhf_codec.decoder.meshfile import write_mesh
from cndhf_codec.decoder.reading import load_stream
from cndhf_codec.errors import OptionError


@pytest.fixture(scope="module")
def model(golden):
    return load(golden / "encoded.cndhf")


@pytest.fixture(scope="module")
def data(golden):
    return (golden / "encoded.cndhf").read_bytes()


class NoNumbers:
    """Like a tensor on a graphics card: it cannot become an array."""

    def __array__(self, *arguments, **options):
        raise TypeError("not on this device")


@pytest.mark.parametrize("resolution", ["big", "64", 64.5, float("nan"), [64], np.array([64, 64]), 64j, b"64"])
def test_resolution(model, resolution):
    for ask in (model.to_mesh, model.occupancy, model.surface):
        with pytest.raises(OptionError, match="a whole number is needed"):
            ask(resolution)


def test_a_resolution_has_to_be_given_where_there_is_no_default(model):
    with pytest.raises(OptionError, match="resolution is None"):
        model.occupancy(None)


@pytest.mark.parametrize("resolution", [16, 16.0, np.int8(16), np.float32(16), np.array(16)])
def test_whole_numbers_of_any_type_do(model, resolution):
    assert model.occupancy(resolution).grid.shape == model.occupancy(16).grid.shape


@pytest.mark.parametrize(
    "points", ["abc", None, {}, object(), NoNumbers(), [["1", "2", "3"]], np.array("2000-01-01", "M8")]
)
def test_points(model, points):
    queries = [model.contains, model.implicit, model.normals, lambda p: model.ray_intersect(p, [1, 0, 0])]
    for ask in [*queries, lambda p: model.ray_intersect([0, 0, 0], p), lambda p: model.heights(0, p)]:
        with pytest.raises(OptionError, match="numbers of shape"):
            ask(points)


@pytest.mark.parametrize("i", ["0", None, 0.5, [0]])
def test_numbers_of_double_height_fields(model, data, i):
    with pytest.raises(OptionError, match="a whole number is needed"):
        model.heights(i, [0, 0])
    with pytest.raises(OptionError, match="a whole number is needed"):
        model.prefix(i)
    if i is not None:
        with pytest.raises(OptionError, match="a whole number is needed"):
            loads_prefix(data, i)


@pytest.mark.parametrize("faces", ["many", [100], 5j])
def test_faces(model, faces):
    with pytest.raises(OptionError, match="a whole number is needed"):
        model.to_mesh(method="intersection", faces=faces)


@pytest.mark.parametrize("method", [3, ["intersection"], True, b"intersection"])
def test_method(model, method):
    with pytest.raises(OptionError, match="method is"):
        model.to_mesh(16, method=method)


@pytest.mark.parametrize("max_error", [[1], {}, True, "", "%", b"1%"])
def test_max_error(model, max_error):
    with pytest.raises(OptionError, match="max_error is"):
        model.to_mesh(method="intersection", max_error=max_error)


@pytest.mark.parametrize("wrong", ["text", 3, None, 2**62, [1, 2], object()])
def test_bytes(wrong):
    for read in (loads, loads_prefix):
        with pytest.raises(OptionError, match=r"the bytes of a \.cndhf file are needed"):
            read(wrong)


def test_bytes_of_any_kind(data):
    for same in (bytearray(data), memoryview(data), np.frombuffer(data, np.uint8)):
        assert loads(same).info == loads(data).info


@pytest.mark.parametrize("wrong", [3, None, b"a.cndhf", ["a.cndhf"], io.BytesIO()])
def test_paths(model, wrong):
    mesh = model.to_mesh(8)
    for use in (
        load,
        model.save,
        lambda p: write_mesh(mesh, p),
        lambda p: write_grid(p, *model.occupancy(8)),
    ):
        with pytest.raises(OptionError, match="a path is needed"):
            use(wrong)


def closed() -> io.BytesIO:
    stream = io.BytesIO()
    stream.close()
    return stream


@pytest.mark.parametrize("stream", [3, None, b"bytes", closed(), io.StringIO("text")])
def test_streams(stream):
    with pytest.raises(OptionError, match="bytes"):
        load_stream(stream, "the stream")


def test_a_file_open_as_text_is_no_binary_stream(golden):
    with open(golden / "encoded.cndhf", encoding="utf-8") as stream, pytest.raises(OptionError, match="reading bytes"):
        load_stream(stream, "the stream")


@pytest.mark.parametrize("name", ["resolution", "tables", "work", "vertices", "nodes"])
@pytest.mark.parametrize("value", ["x", None, [5], 5j])
def test_values_of_limits(name, value):
    with pytest.raises(OptionError, match=f"Limits: {name} is .*; a number is needed"):
        Limits(**{name: value})


def test_limits(model, golden, data):
    for make in (
        lambda x: load(golden / "encoded.cndhf", x),
        lambda x: loads(data, x),
        lambda x: Model(model.container, limits=x),
    ):
        with pytest.raises(OptionError, match="a Limits is needed"):
            make(5)
    other = pickle.loads(pickle.dumps(model))
    with pytest.raises(OptionError, match="a Limits is needed"):
        other.limits = None
    assert other.limits == Limits()
    other.limits = Limits(vertices=float("inf"))
    assert other.to_mesh(8).is_watertight


def test_a_model_is_made_of_a_container():
    with pytest.raises(OptionError, match="see load and loads"):
        Model("a.cndhf")
