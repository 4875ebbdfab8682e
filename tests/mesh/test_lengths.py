"""Lengths and sizes as users write them."""

from __future__ import annotations

import numpy as np
import pytest

from cndhf_codec.errors import OptionError
from cndhf_codec.mesh.lengths import Length, parse_length, parse_size


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("0.2%", None, Length(0.002, True)),
        (" .5 % ", "mm", Length(0.005, True)),
        ("0.25", None, Length(0.25, False)),
        (1e-3, None, Length(0.001, False)),
        ("0.5mm", "mm", Length(0.5, False)),
        ("0.5mm", "m", Length(0.0005, False)),
        ("1 in", "mm", Length(25.4, False)),
    ],
)
def test_errors_as_users_write_them(text, unit, expected):
    got = parse_length(text, unit, "target error")
    assert got.value == pytest.approx(expected.value)
    assert got.relative == expected.relative
    assert got.in_units(10) == pytest.approx(got.value * (10 if got.relative else 1))


@pytest.mark.parametrize(
    ("text", "unit", "match"),
    [
        ("0.5mm", None, "--unit"),
        ("0.5furlongs", "mm", "units are mm"),
        ("0.5", "furlongs", "unit is"),
        ("0", None, "positive"),
        ("-1%", None, "positive"),
        ("nan", None, "positive"),
        ("", None, "positive"),
        (True, None, "positive"),
        ([1], None, "positive"),
    ],
)
def test_what_is_not_an_error(text, unit, match):
    with pytest.raises(OptionError, match=match):
        parse_length(text, unit, "target error")


def test_sizes_as_users_write_them():
    assert [parse_size(t) for t in ("4096", "4KB", "4 KiB", "1.5kb", "2MB")] == [4096, 4000, 4096, 1500, 2_000_000]
    assert [parse_size(t) for t in ("1.5GB", "2 GiB")] == [1_500_000_000, 2**31]
    assert [parse_size(n) for n in (4096, np.int32(4096))] == [4096, 4096]


@pytest.mark.parametrize("bad", ["", "4 apples", "-3", "KB", 4096.5, None, True, b"4KB"])
def test_what_is_not_a_size(bad):
    with pytest.raises(OptionError, match="target size"):
        parse_size(bad)
