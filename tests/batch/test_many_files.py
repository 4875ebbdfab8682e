"""`encode_many` from Python."""

from __future__ import annotations

import pytest
from poisoned import poison, write

from cndhf_codec.batch import encode_many
from cndhf_codec.errors import OptionError


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"preset": "frob"}, "preset is 'frob'"),
        ({"target_size": 1}, "target size"),
        ({"threads": 2}, "see Limits"),
        ({"time_limit": 5}, "see Limits"),
        ({"jobs": 0}, "jobs is 0"),
    ],
)
def test_wrong_options_are_refused_before_any_work(arguments, match):
    with pytest.raises(OptionError, match=match):
        encode_many(["a.obj"], **{"preset": "fast", **arguments})


def test_two_inputs_of_one_name(tmp_path):
    with pytest.raises(OptionError, match="same name"):
        encode_many(["x/a.obj", "y/a.obj"], tmp_path, preset="fast")


@pytest.mark.encode
def test_results_come_as_they_end_with_bytes_or_with_files(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    write(tmp_path / "in", slow="fine 3", quick="fine", bad="bad")
    paths = [tmp_path / "in" / f"{name}.obj" for name in ("slow", "quick", "bad")]
    found = list(encode_many(paths, jobs=2, preset="fast"))
    assert [(r.input, r.outcome) for r in found] == [
        (str(paths[1]), "done"),
        (str(paths[2]), "failed"),
        (str(paths[0]), "done"),
    ]
    assert found[0].data == b"# fine\n" * 2
    assert found[0].output == ""
    (result,) = encode_many([paths[1]], tmp_path / "new" / "out", jobs=1, preset="fast")
    assert (result.output, result.data) == (str(tmp_path / "new" / "out" / "quick.cndhf"), None)
    assert (tmp_path / "new" / "out" / "quick.cndhf").read_bytes() == b"# fine\n" * 2
