"""Containers survive the trip to bytes and back, and the writer refuses what a reader would."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import containers, damaged, rearranged

from cndhf_codec.decoder.model import Model
from cndhf_codec.errors import FormatError, OptionError
from cndhf_codec.format import Container, ControlMesh, DhfRecord, Metadata, dumps, loads
from cndhf_codec.format.container import parameter_count, rotation_matrix, tensor_shapes
from cndhf_codec.format.writer import pack_symbols


def fields(d: DhfRecord) -> tuple:
    return tuple(v for k, v in vars(d).items() if k != "symbols")


@settings(max_examples=60, deadline=None)
@given(containers)
def test_round_trip(c):
    data = dumps(c)
    back = loads(data)
    assert (back.centre, back.scale, back.metadata, back.codec) == (c.centre, c.scale, c.metadata, c.codec)
    assert len(back.dhfs) == len(c.dhfs)
    for a, b in zip(back.dhfs, c.dhfs, strict=True):
        assert fields(a) == fields(b)
        assert all(np.array_equal(s, t) for s, t in zip(a.symbols, b.symbols, strict=True))
    assert dumps(back) == data == dumps(c)


@pytest.mark.encode
@settings(max_examples=200, deadline=None)
@given(damaged() | rearranged())
def test_damage_below_the_checksum_is_a_format_error_or_another_valid_file(data):
    try:
        c = loads(data)
    except FormatError:
        return
    # A file that is accepted is one that the writer can say.
    again = loads(dumps(c))
    assert repr((again.centre, again.scale, again.metadata)) == repr((c.centre, c.scale, c.metadata))
    for a, b in zip(again.dhfs, c.dhfs, strict=True):
        assert fields(a) == fields(b)
        assert all(np.array_equal(s, t) for s, t in zip(a.symbols, b.symbols, strict=True))
    model = Model(c)
    assert np.isfinite(model.heights(0, [[0, 0], [1e30, -1e30]])).all()
    assert np.isfinite(model.implicit([c.centre, (1e308, -1e308, 0)])).all()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 30), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_overhead(widths, seed):
    rng = np.random.default_rng(seed)
    dhfs = tuple(some_record(w, 5, rng) for w in widths)
    data = dumps(Container((0.0, 0.0, 0.0), 1.0, dhfs))
    compressed = zstandard.ZstdCompressor(level=22).compress(pack_symbols(dhfs))
    assert len(data) <= len(compressed) + 27 + 39 * len(widths)


def some_record(width: int = 3, hidden: int = 1, rng: np.random.Generator | None = None, **changes) -> DhfRecord:
    rng = rng or np.random.default_rng(0)
    shapes = tensor_shapes(width, hidden)
    made = DhfRecord(
        quaternion=(0, 0, 0, 32767),
        box=(-10, 10, -10, 10, -10, 10),
        width=width,
        hidden_layers=hidden,
        omega_first=30,
        omega_hidden=30,
        step_codes=(20,) * len(shapes),
        symbols=tuple(np.rint(rng.normal(0, 20, s)).astype(np.int32) for s in shapes),
    )
    return replace(made, **changes)


def container(*dhfs: DhfRecord, **changes) -> Container:
    return replace(Container((0.0, 0.0, 0.0), 1.0, dhfs or (some_record(),)), **changes)


def first_symbol(value: int) -> tuple[np.ndarray, ...]:
    symbols = some_record().symbols
    changed = symbols[0].copy()
    changed[0, 0] = value
    return (changed, *symbols[1:])


@pytest.mark.parametrize(
    "bad",
    [
        container(centre=(math.nan, 0.0, 0.0)),
        container(scale=0.0),
        container(scale=-1.0),
        container(scale=1e39),
        container(scale=1e-60),  # zero as a float32
        container(dhfs=(some_record(),) * 65),
        container(dhfs=(some_record(),) * 300),
        container(some_record(quaternion=(0, 0, 0, 1))),
        container(some_record(quaternion=(0, 0, 0, 40000))),
        container(some_record(box=(5, 5, 0, 1, 0, 1))),
        container(some_record(box=(0, 1, 0, 1, 0, 99999))),
        container(some_record(omega_first=0)),
        container(some_record(omega_hidden=256)),
        container(some_record(fold=4)),
        container(some_record(width=129)),
        container(some_record(hidden=9)),
        container(some_record(step_codes=(20,) * 5)),
        container(some_record(step_codes=(-1,) * 6)),
        container(some_record(step_codes=(128,) * 6)),
        container(some_record(step_codes=(256,) * 6)),
        # A code above 127 on a wide tensor would be read as another code.
        container(some_record(step_codes=(148,) + (20,) * 5, symbols=first_symbol(500))),
        container(some_record(symbols=first_symbol(32768))),
        container(some_record(symbols=first_symbol(-32768))),
        container(some_record(symbols=some_record(4).symbols)),
        container(some_record(symbols=tuple(s.ravel() for s in some_record().symbols))),
        container(metadata=Metadata(encoder="x" * 256)),
        container(metadata=Metadata(source="ü" * 128)),
        container(metadata=Metadata(source="\udcff.obj")),  # a file name that is not UTF-8
        container(metadata=Metadata(mean_error=1.0)),
        container(metadata=Metadata(None, -1.0, 1.0, 1.0)),
        container(metadata=Metadata(None, 1.0, math.nan, 1.0)),
        container(metadata=Metadata(None, 1.0, 1.0, 3.4e38)),
    ],
)
def test_writer_refuses_what_no_reader_would_read(bad):
    with pytest.raises(OptionError):
        dumps(bad)


def test_a_container_holds_one_representation():
    none = np.empty((0, 2), np.int32)
    mesh = ControlMesh((0, 0, 0, 32767), 0.1, np.eye(3, dtype=np.int32), np.array([[0, 1, 2]], np.int32), none)
    for bad in ({"dhfs": ()}, {"surface": mesh}):
        with pytest.raises(OptionError, match="either double height fields or a surface"):
            container(**bad)
    assert container(dhfs=(), surface=mesh).surface is mesh


@pytest.mark.parametrize("value", [32767, -32767])
def test_extreme_symbols_are_written(value):
    assert loads(dumps(container(some_record(symbols=first_symbol(value))))).dhfs[0].symbols[0][0, 0] == value


def test_packing_puts_high_bytes_of_wide_tensors_last():
    symbols = (
        np.array([[0, -1], [1, -2]], np.int32),
        np.array([128, 0], np.int32),  # zigzag 256
        np.array([[127, -128], [0, 0]], np.int32),  # zigzag 254, 255: still one byte each
        np.array([0, 0], np.int32),
        np.zeros((2, 2), np.int32),
        np.array([-32767, 3], np.int32),  # zigzag 65533
    )
    packed = pack_symbols((some_record(2, symbols=symbols),))
    low = [0, 1, 2, 3, 0, 0, 254, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0xFD, 6]
    assert list(packed) == [*low, 1, 0, 0xFF, 0]


@pytest.mark.parametrize("width", [1, 17, 30])
def test_parameter_count(width):
    assert parameter_count(width, 5) == 5 * width**2 + 10 * width + 2
    assert parameter_count(width, 5) == sum(math.prod(s) for s in tensor_shapes(width, 5))


def test_rotation_of_quarter_turns_is_exact():
    half = 23170
    about_x = rotation_matrix((half, 0, 0, half))
    assert about_x.tolist() == [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert rotation_matrix((0, 0, half, half)).tolist() == [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    assert rotation_matrix((0, half, 0, half)).tolist() == [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
