"""Floats of 16 bits, rounded up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cndhf_codec.errors import OptionError
from cndhf_codec.format.bfloat16 import INFINITY, above, bits_above, from_bits

LARGEST = from_bits(INFINITY - 1)


@given(st.floats(0, LARGEST))
def test_the_least_that_is_not_below(value):
    bits = bits_above(value)
    assert from_bits(bits) >= value
    assert bits == 0 or from_bits(bits - 1) < value


@pytest.mark.parametrize("bits", [0, 1, 0x3F80, 0x3F81, INFINITY - 1])
def test_a_bfloat16_is_left_as_it_is(bits):
    value = from_bits(bits)
    assert np.array(value, dtype=np.float32).view(np.uint32) == bits << 16
    assert bits_above(value) == bits


def test_a_little_above_is_the_next():
    # So little that a float32 does not tell the difference.
    assert above(1 + 2.0**-50) == 1 + 2.0**-7
    assert bits_above(2.0**-200) == 1


@pytest.mark.parametrize("value", [-1.0, -1e-300, math.nan, math.inf, LARGEST * 1.001, 3.4028235e38, 1e300])
def test_what_does_not_fit(value):
    with pytest.raises(OptionError, match="does not fit the format"):
        bits_above(value)
