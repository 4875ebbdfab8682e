"""Codec 2: what goes in comes out, in close to the ideal number of bytes, and damage does not pass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cndhf_codec.errors import FormatError, OptionError, PayloadError
from cndhf_codec.format import rans
from cndhf_codec.format.constants import MAX_SYMBOL

FROZEN = "09 00 53 53 cb 29 fe 7f 01 2c ff 7f ff 7e ff 7f ff 01"


def tensor(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


@given(st.lists(st.lists(st.integers(-MAX_SYMBOL, MAX_SYMBOL), min_size=1, max_size=30), min_size=1, max_size=6))
@settings(max_examples=100, deadline=None)
def test_round_trip(values):
    tensors = [tensor(*v) for v in values]
    body = rans.encode(tensors)
    back = rans.decode(body, [t.size for t in tensors])
    assert all(np.array_equal(a, b) for a, b in zip(back, tensors, strict=True))


@pytest.mark.parametrize("deviation", [0.3, 1, 5, 12, 40, 300, 5000])
def test_a_gaussian_costs_its_entropy(deviation):
    values = np.rint(np.random.default_rng(0).normal(0, deviation, 20_000)).clip(-MAX_SYMBOL, MAX_SYMBOL)
    _, counts = np.unique(values, return_counts=True)
    p = counts / counts.sum()
    # The counted entropy underestimates that of a wide distribution; the Gaussian's formula does not.
    bits = -(p * np.log2(p)).sum() if deviation < 20 else np.log2(deviation * np.sqrt(2 * np.pi * np.e))
    assert len(rans.encode([values.astype(np.int32)])) * 8 / len(values) < 1.01 * bits + 0.01


def test_the_estimate_is_the_size():
    rng = np.random.default_rng(1)
    tensors = [rng.normal(0, s, 200).astype(np.int32) for s in (0.5, 8, 100, 3000)]
    assert rans.encoded_size(tensors) == pytest.approx(len(rans.encode(tensors)), abs=3)


@pytest.mark.parametrize("code", range(rans.SCALE_CODES))
def test_every_table_is_a_distribution(code):
    table = rans.frequencies(code)
    assert len(table) == rans.BUCKETS
    assert sum(table) == 2**rans.TOTAL_BITS
    assert min(table) >= 1


def test_frozen_bytes():
    body = rans.encode([tensor(0, 1, -1, 2, -300), tensor(32767, -32767)])
    assert body.hex(" ") == FROZEN
    assert [t.tolist() for t in rans.decode(bytes.fromhex(FROZEN), [5, 2])] == [[0, 1, -1, 2, -300], [32767, -32767]]


def test_rising_tensors_are_coded_as_their_differences():
    rng = np.random.default_rng(0)
    values = rng.integers(0, 100, 20).astype(np.int32)
    rising = np.sort(values)
    assert rans.encode([rising])[0] & rans.RISING
    assert not rans.encode([values])[0] & rans.RISING
    assert rans.decode(rans.encode([rising]), [20])[0].tolist() == rising.tolist()
    # Order and sign are worth log2(20!) + 20 bits = 10 bytes to Gaussian numbers.
    assert len(rans.encode([rising])) <= len(rans.encode([values])) - 9


def test_a_rising_tensor_that_rises_too_far_is_refused(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(rans, "MAX_SYMBOL", 40_000)
        body = rans.encode([tensor(20_000, 40_000)])
    with pytest.raises(PayloadError, match="beyond 32767"):
        rans.decode(body, [2])


def test_every_truncation_and_extension_is_refused():
    body = rans.encode([np.arange(-20, 20, dtype=np.int32)])
    for length in range(len(body)):
        with pytest.raises(FormatError):
            rans.decode(body[:length], [40])
    with pytest.raises(PayloadError):
        rans.decode(body + b"\0", [40])


def test_too_large_symbols_are_not_written():
    with pytest.raises(OptionError):
        rans.encode([tensor(MAX_SYMBOL + 1)])
