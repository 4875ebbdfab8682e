"""Frozen files that each abuse the format in one way, and frozen files that look odd but are right.

A file that is missing, or in the folder but not in its index, is a failure: nothing here makes one. See
tools/spec_vectors.py.
"""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import cndhf_codec
from cndhf_codec import errors

MUST_FAIL, MUST_LOAD = ROOT / "spec/vectors/refused", ROOT / "spec/vectors/accepted"


def index(folder: Path) -> list[list[str]]:
    return [line.split("\t") for line in (folder / "index.tsv").read_text("utf-8").splitlines()]


@pytest.mark.parametrize("folder", [MUST_FAIL, MUST_LOAD])
def test_the_index_names_every_file_and_no_other(folder):
    named = [row[0] for row in index(folder)]
    assert sorted(named) == sorted(p.name for p in folder.glob("*.cndhf"))
    assert len(named) > 10


@pytest.mark.parametrize(
    ("name", "_section", "error", "words"), index(MUST_FAIL), ids=lambda cell: cell.removesuffix(".cndhf")
)
def test_must_fail(name, _section, error, words):
    tracemalloc.start()
    try:
        with pytest.raises(errors.FormatError) as caught:
            cndhf_codec.load(MUST_FAIL / name)
        # The largest network block that a valid file may announce is 1 MiB: anything near that is fine, the
        # hundreds of megabytes on offer in the bombs are not.
        assert tracemalloc.get_traced_memory()[1] < 12 * 2**20
    finally:
        tracemalloc.stop()
    assert type(caught.value) is getattr(errors, error)
    assert re.search(words, str(caught.value))
    assert str(MUST_FAIL / name) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(("name", "_why"), index(MUST_LOAD), ids=lambda cell: cell.removesuffix(".cndhf"))
def test_must_load(name, _why):
    model = cndhf_codec.load(MUST_LOAD / name)
    (dhf,) = model.container.dhfs
    expected = cndhf_codec.load(MUST_LOAD / "valid.cndhf").container.dhfs[0]
    assert all(np.array_equal(a, b) for a, b in zip(dhf.symbols, expected.symbols, strict=True))
    assert dhf.step_codes == expected.step_codes
    centre = np.array(model.container.centre)
    assert np.isfinite(model.heights(0, [[0, 0], [1e9, -1e9]])).all()
    assert np.isfinite(model.implicit(centre))


@pytest.mark.parametrize("name", ["encoded.cndhf", "by-hand.cndhf"])
def test_every_truncation_of_a_golden_file(golden, name):
    data = (golden / name).read_bytes()
    for length in range(len(data)):
        with pytest.raises((errors.TruncatedError, errors.ChecksumError)):
            cndhf_codec.loads(data[:length])


@pytest.mark.parametrize("name", ["encoded.cndhf", "by-hand.cndhf"])
def test_every_flipped_byte_of_a_golden_file(golden, name):
    data = (golden / name).read_bytes()
    for at in range(len(data)):
        with pytest.raises(errors.FormatError):
            cndhf_codec.loads(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
