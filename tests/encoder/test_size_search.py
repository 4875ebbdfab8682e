"""Encoding to an error: the search for the smallest file."""

from __future__ import annotations

from functools import partial
from itertools import count
from types import SimpleNamespace

import pytest
from quietly import encode_quietly

from cndhf_codec.encoder import compiling, deadline, settings, size_search
from cndhf_codec.encoder.size_search import ErrorLimits, smallest_file
from cndhf_codec.errors import EncodeError, OptionError
from cndhf_codec.mesh.distances import Distances
from cndhf_codec.mesh.lengths import parse_length

pytestmark = pytest.mark.encode


def error_of(size: int, power: float = 0.9, floor: float = 0.0) -> float:
    return floor + 100 * size**-power


@pytest.mark.parametrize("wanted", [700, 1500, 3900, 4096, 4200, 9000, 20_000])
@pytest.mark.parametrize(("power", "floor"), [(0.9, 0.0), (0.6, 0.0), (1.3, 0.0), (0.9, 0.005)])
def test_the_search_finds_a_size_a_little_above_the_smallest(wanted, power, floor):
    tried = []

    def attempt(size, more):
        tried.append(size)
        assert more == size_search.TRIES - len(tried)
        return size, error_of(size, power, floor) / error_of(wanted, power, floor)

    found = smallest_file(attempt, "so much")
    assert wanted <= found <= 1.15 * wanted
    assert len(tried) <= size_search.TRIES
    assert len(set(tried)) == len(tried)


@pytest.mark.parametrize("wanted", [900, 1400, 2300])
def test_a_size_from_which_on_nothing_is_lost(wanted):
    # As of flat parts: at some size the error falls to almost nothing.
    def attempt(size, more):
        return size, 1e-3 if size > 1.02 * wanted else (wanted / size) ** 0.9

    found = smallest_file(attempt, "so much")
    assert wanted <= found <= 1.3 * wanted


def test_the_smallest_file_of_all_is_taken_when_it_will_do():
    assert smallest_file(lambda size, more: (size, 0.0), "so much") == size_search.SMALLEST_SIZE


def test_an_error_out_of_reach_says_what_was_reached():
    message = rf"a mean error of 0\.001, .* was not reached.*500 times .* at {size_search.LARGEST_SIZE} bytes"
    with pytest.raises(EncodeError, match=message):
        smallest_file(lambda size, more: (size, 500.0), "a mean error of 0.001")


def test_the_worse_of_two_errors_decides():
    asked = ErrorLimits(parse_length("1%", None, "target error"), parse_length(0.5, None, "target max"))
    assert asked.excess(Distances(0.02, 0.1, 0.4), 2.0) == pytest.approx(1)
    assert asked.excess(Distances(0.01, 0.1, 1.0), 2.0) == pytest.approx(2)
    assert asked.text(2.0) == "a mean error of 0.02 and a maximum error of 0.5"
    assert ErrorLimits(None, asked.maximum).excess(Distances(9.0, 9.0, 0.25), 2.0) == pytest.approx(0.5)


@pytest.mark.parametrize("representation", ["dhf", "surface"])
def test_an_encode_to_a_maximum_error(creature, tiny, monkeypatch, representation):
    monkeypatch.setattr(size_search, "FIRST_SIZE", 1500)
    options = {"preset": "fast", "representation": representation}
    most = "40%" if representation == "dhf" else "5%"
    model, report = encode_quietly(creature, target_max=most, **options)
    assert report.distances.maximum <= float(most[:-1]) / 100 * report.diagonal
    assert model.info["bytes"] < 1500
    monkeypatch.setattr(size_search, "LARGEST_SIZE", 1500)
    with pytest.raises(EncodeError, match=r"a mean error of .* and a maximum error of .* not reached"):
        encode_quietly(creature, target_error="50%", target_max="0.0001%", **options)


def test_an_encode_to_an_error(creature, tiny, monkeypatch):
    monkeypatch.setattr(size_search, "FIRST_SIZE", 1500)
    model, report = encode_quietly(creature, preset="fast", representation="dhf", target_error="8%")
    assert report.distances.mean <= 0.08 * report.diagonal
    assert 1 <= model.info["mean_error"] / report.distances.mean < 1 + 2**-7  # rounded up to 8 bits
    assert model.info["bytes"] == len(model.dumps()) < 1500
    monkeypatch.setattr(size_search, "LARGEST_SIZE", 1500)
    with pytest.raises(EncodeError, match="not reached"):
        encode_quietly(creature, preset="fast", representation="dhf", target_error="0.0001%")


def test_an_error_and_a_size_exclude_each_other(creature):
    for options in ({"target_size": 4096}, {"width": 8}):
        with pytest.raises(OptionError, match="target error decides"):
            encode_quietly(creature, preset="fast", representation="dhf", target_error="1%", **options)
    with pytest.raises(OptionError, match="target error decides"):
        encode_quietly(creature, preset="paper", target_error="1%")
    with pytest.raises(OptionError, match="time limit"):
        encode_quietly(creature, preset="fast", representation="dhf", time_limit=0)


def test_what_was_found_is_kept_where_a_later_size_fails():
    def attempt(size, more):
        if size < 4000:
            raise EncodeError("no time")
        return size, 4000 / size

    found = size_search.smallest_file(attempt, "a mean error of 1")
    assert found >= 4000
    with pytest.raises(EncodeError, match="no time"):
        size_search.smallest_file(lambda size, more: attempt(1000, more), "a mean error of 1")


def test_a_time_limit_shortens_the_fit(creature, tiny, monkeypatch):
    endless = settings.replace(settings.PRESETS["fast"], steps=10**7, joint_steps=10**7, round_steps=10**7)
    monkeypatch.setitem(settings.PRESETS, "fast", endless)
    # A clock that goes on by a hundredth of a second per look.
    monkeypatch.setattr(compiling, "time", SimpleNamespace(monotonic=partial(next, count(0, 0.01))))
    _, report = encode_quietly(creature, preset="fast", representation="dhf", width=8, time_limit=12, threads=1)
    assert report.normalised.mean < 0.1


def test_a_poor_fit_within_a_time_limit_is_an_error(creature, tiny, monkeypatch):
    from cndhf_codec.encoder import report

    monkeypatch.setattr(report, "POOR_ERROR", 0.0)
    with pytest.raises(EncodeError, match="within the time limit of 1000 s only a poor fit was reached"):
        encode_quietly(creature, preset="fast", width=8, time_limit=1000)
    encode_quietly(creature, preset="fast", width=8)


def test_rounding_gets_the_time_that_it_takes(creature, monkeypatch):
    from types import SimpleNamespace as Some

    from cndhf_codec.encoder.dhf import encode

    job = Some(settings=settings.PRESETS["default"], threads=Some(threads=2))
    assert encode._fit_share(job, Some(widths=[30]), deadline.Deadline()) == encode.FIT_SHARE
    # A clock on which every product takes a second.
    monkeypatch.setattr(encode, "time", Some(perf_counter=partial(next, count(0, 1))))
    share = [encode._fit_share(job, Some(widths=[w]), deadline.Deadline(1000)) for w in (5, 12, 30)]
    assert share[0] == encode.FIT_SHARE >= share[1] > share[2] == encode.LEAST_FIT_SHARE
