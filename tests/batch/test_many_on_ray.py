"""The same worker as tasks of Ray, on this machine."""

from __future__ import annotations

import os
import signal
import sys

import pytest
from poisoned import poison, write

from cndhf_codec.batch import Limits, encode_many
from cndhf_codec.errors import OptionError

ray = pytest.importorskip("ray")
psutil = pytest.importorskip("psutil")
pytestmark = [
    pytest.mark.encode,
    pytest.mark.skipif(sys.platform == "win32", reason="Ray for Windows is experimental"),
    # Ray leaves sockets and its log files open.
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore:.*accelerator visible devices.*:FutureWarning"),
]


def test_a_ray_worker_that_is_killed_loses_nothing_and_a_crash_is_named(tmp_path, monkeypatch):
    poison(tmp_path / "custom", monkeypatch)
    lines = {f"m{k}": "fine 1" for k in range(4)}
    write(tmp_path / "in", **lines, crash="crash", hang="hang")
    paths = sorted((tmp_path / "in").iterdir())
    found, killed = {}, 0
    for result in encode_many(paths, tmp_path / "out", jobs=2, ray="local", limits=Limits(timeout=6), preset="fast"):
        found[os.path.basename(result.input)] = result
        if len(found) == 2:
            for process in psutil.Process().children(recursive=True):
                if process.name().startswith("ray::") and "_encode" in process.name():
                    process.send_signal(signal.SIGKILL)
                    killed += 1
                    break
    assert killed == 1
    assert {name: r.outcome for name, r in found.items()} == {
        **{f"{name}.obj": "done" for name in lines},
        "crash.obj": "crashed",
        "hang.obj": "timeout",
    }
    assert "SIGSEGV" in found["crash.obj"].reason
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [f"{name}.cndhf" for name in lines]
    assert not ray.is_initialized()


def test_no_cluster_at_an_address():
    with pytest.raises(OptionError, match=r"no cluster at 127.0.0.1:1 .*ray start"):
        list(encode_many([], ray="127.0.0.1:1", preset="fast"))
