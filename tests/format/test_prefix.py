"""The first DHFs from the first bytes of a file."""

from __future__ import annotations

import contextlib
import dataclasses

import analytic
import numpy as np
import pytest
import rawfile
from analytic import ABOUT_Y_90, slab, waves

from cndhf_codec import Limits, loads, loads_prefix
from cndhf_codec.errors import FormatError, OptionError, PayloadError, SectionError, TruncatedError
from cndhf_codec.format import Metadata, dumps, rans, read_header, section_sizes
from cndhf_codec.format.constants import CODEC_RANS


@pytest.fixture
def model():
    container = analytic.model(waves(1), waves(2, ABOUT_Y_90), slab((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))).container
    metadata = Metadata("test", 0.1, 0.2, 0.3, "mesh")
    return loads(dumps(dataclasses.replace(container, codec=CODEC_RANS, metadata=metadata)))


def needed(data: bytes, n_dhfs: int) -> int:
    """The least number of bytes from which so many DHFs can be read."""
    for size in range(len(data) + 1):
        try:
            loads_prefix(data[:size], n_dhfs)
        except TruncatedError:
            continue
        return size
    raise AssertionError("not even from the whole file")


def test_each_dhf_comes_with_its_own_bytes(model):
    data = model.dumps()
    sizes = [needed(data, k) for k in (1, 2, 3)]
    records = [d.symbols for d in model.container.dhfs]
    start = read_header(data).shape.offset + section_sizes(data)["records"]
    for k, size in enumerate(sizes, 1):
        # What coding these alone takes, and the scale codes of all.
        alone = len(rans.encode([s for r in records[:k] for s in r]))
        assert abs(size - start - alone) <= 6 * (3 - k) + 4
    assert sizes[0] < sizes[1] < sizes[2] < len(data)


def test_a_prefix_is_the_solid_of_the_first_dhfs(model):
    data = model.dumps()
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (2000, 3))
    whole = model.implicit(points)
    for k in (1, 2, 3):
        part = loads_prefix(data[: needed(data, k)])
        assert len(part.container.dhfs) == k
        f = part.implicit(points)
        assert np.array_equal(f, model.prefix(k).implicit(points))
        assert np.all(f >= whole)
        assert part.container.metadata == Metadata()
        assert loads(part.dumps()).dumps() == part.dumps()
    assert np.array_equal(f, whole)


def test_as_many_as_there_are(model):
    data = model.dumps()
    counts = []
    for size in range(needed(data, 1), len(data) + 1, 7):
        counts.append(len(loads_prefix(data[:size]).container.dhfs))
    assert sorted(set(counts)) == [1, 2, 3]
    assert counts == sorted(counts)
    # A DHF asked for alone needs no more.
    assert len(loads_prefix(data, 1).container.dhfs) == 1


def test_too_few_bytes_are_a_truncation(model):
    data = model.dumps()
    for size in range(needed(data, 1)):
        with pytest.raises(TruncatedError):
            loads_prefix(data[:size])
    with pytest.raises(TruncatedError, match="before DHF 1"):
        loads_prefix(data[: needed(data, 2) - 1], 2)


@pytest.mark.parametrize("n_dhfs", [0, 4, -1])
def test_there_are_no_so_many(model, n_dhfs):
    with pytest.raises(OptionError, match="there are no"):
        loads_prefix(model.dumps(), n_dhfs)
    with pytest.raises(OptionError, match="there are no"):
        model.prefix(n_dhfs)


def test_codec_1_has_no_prefix():
    data = analytic.model(waves(1)).dumps()
    with pytest.raises(SectionError, match="codec 1"):
        loads_prefix(data)


def test_what_stands_around_the_shape(model):
    whole = model.dumps()
    header = read_header(whole)
    shape = whole[header.shape.offset :][: header.shape.length]
    data = rawfile.build([(0x90, bytes(200)), (rawfile.SOURCE, b"a"), (rawfile.RANS, shape), (0x07, b"unknown")])
    with pytest.raises(SectionError, match="kind 7"):
        loads(data)
    # What follows the shape is not looked at; what comes before it is.
    assert len(loads_prefix(data, limits=Limits(resolution=20)).container.dhfs) == 3
    assert loads_prefix(data, limits=Limits(resolution=20)).limits.resolution == 20
    with pytest.raises(SectionError, match="kind 7"):
        loads_prefix(rawfile.build([(0x07, b"unknown"), (rawfile.RANS, shape)]))
    with pytest.raises(TruncatedError, match="before its shape"):
        loads_prefix(data[:100])


def test_fields_are_checked_but_damage_of_weights_may_pass(model):
    data = bytearray(model.dumps())
    for at in range(len(data) - 40):
        damaged = bytes(data[:at]) + bytes([data[at] ^ 0x55]) + bytes(data[at + 1 :])
        with contextlib.suppress(FormatError):
            loads_prefix(damaged)
    at = read_header(bytes(data)).shape.offset
    impossible = bytes(data[:at]) + b"\0" + bytes(data[at + 1 :])
    with pytest.raises(FormatError, match="n_dhfs"):
        loads_prefix(impossible)


def test_a_claim_of_endless_symbols_is_stopped():
    # A symbol of a narrow distribution costs next to nothing: a short body must not bring a million of them.
    body = rans.encode([np.zeros(3, np.int32)])
    assert rans.decode_prefix(body, [1_000_000], 1) == []
    with pytest.raises(PayloadError):
        rans.decode(body, [2])
